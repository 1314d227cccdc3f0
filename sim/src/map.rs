//! From a seed to a map: blocks are drawn one after another and attached to a free
//! socket of the previous block. A block that would overlap an earlier one is sampled
//! again; after five tries the block before it is sampled again.
//!
//! The map of a seed equals MetaDrive's (commit c29cc37), because the same
//! random streams are drawn from in the same order. Source:
//! `component/algorithm/BIG.py`.

mod search;

use crate::block::{Draft, Parameters, RoadName};
use crate::road::{Direction, LaneId, Network, RoadId};

pub use crate::block::BlockKind;

/// Most blocks a map may have, beside the first: ids are 16 bits wide and a
/// roundabout of five lanes has some 120 lanes.
pub const MAX_BLOCKS: usize = 256;
/// Fewest and most lanes in one direction
/// (`PGBlockDistConfig.MIN_LANE_NUM`, `MAX_LANE_NUM`).
pub const LANE_COUNTS: std::ops::RangeInclusive<usize> = 1..=5;
/// Narrowest and widest lane, m: the widest truck is 2.3 m; wider lanes leave
/// no room inside the sharpest bends.
pub const LANE_WIDTHS_M: std::ops::RangeInclusive<f64> = 2.5..=5.0;
/// Shortest and longest first block, m.
pub const EXIT_LENGTHS_M: std::ops::RangeInclusive<f64> = 20.0..=1000.0;

const _: () = assert!((MAX_BLOCKS + 1) * 240 <= u16::MAX as usize);

/// Which blocks follow the first one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BlockPlan {
    /// That many, drawn by [`BlockKind::WEIGHTS`].
    Random(usize),
    /// These, in order.
    Sequence(Vec<BlockKind>),
}

impl BlockPlan {
    /// Reads a sequence such as `SCrRXTO`.
    ///
    /// # Errors
    /// [`MapError::UnknownBlock`] at the first other letter.
    pub fn parse(letters: &str) -> Result<BlockPlan, MapError> {
        letters
            .chars()
            .map(|letter| BlockKind::from_letter(letter).ok_or(MapError::UnknownBlock(letter)))
            .collect::<Result<_, _>>()
            .map(BlockPlan::Sequence)
    }

    /// Number of blocks, without the first.
    pub fn len(&self) -> usize {
        match self {
            BlockPlan::Random(count) => *count,
            BlockPlan::Sequence(kinds) => kinds.len(),
        }
    }

    /// Whether nothing follows the first block.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// What maps are like; the defaults are the paper's experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct MapConfig {
    /// Which blocks follow the first one.
    pub blocks: BlockPlan,
    /// Lanes in one direction.
    pub lane_count: usize,
    /// Width of a lane, m.
    pub lane_width_m: f64,
    /// Length of the first block, m.
    pub exit_length_m: f64,
}

impl Default for MapConfig {
    fn default() -> MapConfig {
        MapConfig {
            blocks: BlockPlan::Random(3),
            lane_count: 3,
            lane_width_m: 3.5,
            exit_length_m: 50.0,
        }
    }
}

/// Why there is no map.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MapError {
    /// A letter that names no block.
    #[error("no block is called {0:?}: a map is a sequence of the letters S C r R X T O")]
    UnknownBlock(char),
    /// The first block cannot be repeated.
    #[error("the first block can only be the first: leave it out of the sequence")]
    FirstBlock,
    /// Too many blocks.
    #[error("{0} blocks are more than the {MAX_BLOCKS} that a map can hold")]
    TooManyBlocks(usize),
    /// A number of lanes that blocks cannot have.
    #[error("{0} lanes in one direction: it must be {LANE_COUNTS:?}")]
    LaneCount(usize),
    /// A lane width that blocks cannot have.
    #[error("lanes of {0} m: it must be {LANE_WIDTHS_M:?} m")]
    LaneWidth(f64),
    /// A first block of impossible length.
    #[error("a first block of {0} m: it must be {EXIT_LENGTHS_M:?} m")]
    ExitLength(f64),
    /// The blocks do not fit together.
    #[error("found no way to lay the blocks of seed {seed} in {tries} tries: use fewer blocks")]
    NoMap {
        /// The map's seed.
        seed: u64,
        /// How many blocks were tried.
        tries: u32,
    },
}

impl MapConfig {
    fn check(&self) -> Result<(), MapError> {
        if self.blocks.len() > MAX_BLOCKS {
            return Err(MapError::TooManyBlocks(self.blocks.len()));
        }
        if let BlockPlan::Sequence(kinds) = &self.blocks
            && kinds.contains(&BlockKind::First)
        {
            return Err(MapError::FirstBlock);
        }
        if !LANE_COUNTS.contains(&self.lane_count) {
            return Err(MapError::LaneCount(self.lane_count));
        }
        if !LANE_WIDTHS_M.contains(&self.lane_width_m) {
            return Err(MapError::LaneWidth(self.lane_width_m));
        }
        if !EXIT_LENGTHS_M.contains(&self.exit_length_m) {
            return Err(MapError::ExitLength(self.exit_length_m));
        }
        Ok(())
    }
}

/// A pair of roads to which a next block is, or could be, attached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Socket {
    /// Its number in its block; a T-intersection leaves a gap.
    pub number: u8,
    /// Out of the block.
    pub positive: RoadId,
    /// Into the block.
    pub negative: RoadId,
}

/// One block of a map.
#[derive(Clone, Debug)]
pub struct Block {
    /// Its kind.
    pub kind: BlockKind,
    /// Seed of its own stream.
    pub seed: u64,
    /// How many samples it took; 0 for the first block.
    pub trials: u32,
    /// The sampled measures.
    pub parameters: Parameters,
    /// The socket of the block before that it is attached to.
    pub entry: Option<Socket>,
    /// Its own sockets.
    pub sockets: Vec<Socket>,
    /// Its main road, in driving order, where obstacles may stand: one road
    /// for a straight block, two for bends and ramps, none for crossings.
    pub main_roads: Vec<RoadId>,
    /// Roads on which traffic is placed.
    pub traffic_roads: Vec<RoadId>,
}

/// A map: its roads, and the blocks that they belong to.
#[derive(Clone, Debug)]
pub struct Map {
    /// The seed that made it.
    pub seed: u64,
    /// All roads.
    pub network: Network,
    /// All blocks, in order.
    pub blocks: Vec<Block>,
    /// The lanes on which an episode may begin, left to right.
    pub spawn_lanes: Vec<LaneId>,
    /// Width of the lanes, m.
    pub lane_width_m: f64,
}

impl Map {
    /// Generates the map of a seed.
    ///
    /// # Errors
    /// [`MapError`] if the configuration is out of range, or if the blocks
    /// cannot be laid without running over each other.
    pub fn generate(config: &MapConfig, seed: u64) -> Result<Map, MapError> {
        config.check()?;
        let laid = search::lay_blocks(config, seed)?;
        Ok(finish(config, seed, &laid))
    }
}

fn finish(config: &MapConfig, seed: u64, laid: &[search::Laid]) -> Map {
    let drafts = laid.iter().flat_map(|block| &block.draft.roads);
    let network = Network::new(drafts.map(|road| (road.name.from, road.name.to, &road.lanes[..])));
    let mut blocks: Vec<Block> = Vec::with_capacity(laid.len());
    for block in laid {
        let entry = blocks
            .last()
            .and_then(|before| {
                before
                    .sockets
                    .iter()
                    .find(|s| Some(s.number) == block.entry)
            })
            .copied();
        blocks.push(finish_block(&network, block, entry));
    }
    let spawn_lanes = network.lane_ids(RoadId(0)).collect();
    Map {
        seed,
        network,
        blocks,
        spawn_lanes,
        lane_width_m: config.lane_width_m,
    }
}

fn finish_block(network: &Network, laid: &search::Laid, entry: Option<Socket>) -> Block {
    let draft = &laid.draft;
    let sockets: Vec<Socket> = draft
        .sockets
        .iter()
        .filter_map(|socket| {
            Some(Socket {
                number: socket.number,
                positive: find(network, socket.positive)?,
                negative: find(network, socket.positive.opposite())?,
            })
        })
        .collect();
    Block {
        kind: laid.kind,
        seed: laid.seed,
        trials: laid.trials,
        parameters: laid.parameters,
        entry,
        main_roads: main_roads(network, laid.kind, draft),
        traffic_roads: traffic_roads(network, laid.kind, draft),
        sockets,
    }
}

fn find(network: &Network, name: RoadName) -> Option<RoadId> {
    network.road_between(network.node(name.from)?, network.node(name.to)?)
}

/// The roads of the block that lead outbound, in the network's order.
fn outbound_roads(network: &Network, draft: &Draft) -> Vec<RoadId> {
    let mut roads: Vec<RoadId> = draft
        .roads
        .iter()
        .filter(|road| road.name.to.direction == Direction::Outbound)
        .filter_map(|road| find(network, road.name))
        .collect();
    roads.sort_unstable();
    roads
}

/// Where obstacles may stand (`TrafficObjectManager.reset`).
fn main_roads(network: &Network, kind: BlockKind, draft: &Draft) -> Vec<RoadId> {
    let count = match kind {
        BlockKind::Straight => 1,
        BlockKind::Curve | BlockKind::InRamp | BlockKind::OutRamp => 2,
        BlockKind::First
        | BlockKind::Intersection
        | BlockKind::TIntersection
        | BlockKind::Roundabout => 0,
    };
    let main = draft
        .roads
        .iter()
        .filter(|road| road.name.to.direction == Direction::Outbound && road.name.to.part == 0);
    main.take(count)
        .filter_map(|road| find(network, road.name))
        .collect()
}

/// Where traffic is placed (`get_intermediate_spawn_lanes` of each block).
fn traffic_roads(network: &Network, kind: BlockKind, draft: &Draft) -> Vec<RoadId> {
    let entries = draft.traffic_entries.iter().chain(&draft.ring);
    match kind {
        BlockKind::First => Vec::new(),
        BlockKind::Straight | BlockKind::Curve | BlockKind::OutRamp => {
            outbound_roads(network, draft)
        }
        BlockKind::InRamp => {
            let socket = draft
                .sockets
                .first()
                .and_then(|s| find(network, s.positive));
            let mut roads = outbound_roads(network, draft);
            roads.retain(|&road| Some(road) != socket);
            roads
        }
        BlockKind::Intersection | BlockKind::TIntersection | BlockKind::Roundabout => {
            entries.filter_map(|&name| find(network, name)).collect()
        }
    }
}
