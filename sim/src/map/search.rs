//! The search for blocks that fit together.

use super::{BlockPlan, MapConfig, MapError};
use crate::block::{BlockKind, Builder, Draft, Entry, Parameters, first};
use crate::rng::Stream;

/// How often one block is sampled before the one before it is (`MAX_TRIAL`).
const MAX_TRIALS: u32 = 5;
/// Blocks have seeds below this.
const BLOCK_SEEDS: u32 = 10_000;
/// After so many samples the search gives up. Maps of three blocks need about
/// three; the simulator itself would search for ever.
const MAX_TRIES: u32 = 20_000;

/// A block that has been laid, or is about to be.
pub(super) struct Laid {
    pub kind: BlockKind,
    pub seed: u64,
    pub trials: u32,
    pub parameters: Parameters,
    /// Number of the socket of the block before that it is attached to.
    pub entry: Option<u8>,
    pub draft: Draft,
    stream: Option<Stream>,
}

/// Lays the blocks of a map, the first one included.
pub(super) fn lay_blocks(config: &MapConfig, seed: u64) -> Result<Vec<Laid>, MapError> {
    let mut stream = Stream::new(seed);
    let mut laid = vec![Laid {
        kind: BlockKind::First,
        seed: 0,
        trials: 0,
        parameters: Parameters::Fixed,
        entry: None,
        draft: first(config.lane_count, config.lane_width_m, config.exit_length_m),
        stream: None,
    }];
    let mut tries = 0;
    while laid.len() <= config.blocks.len() {
        draw(&mut stream, &config.blocks, &mut laid);
        // Sample the newest block until it fits. When it has used up its
        // trials, forget it and sample the one before it again instead; the
        // first block needs no sample, and then a new second one is drawn.
        while laid.len() > 1 {
            let newest = laid.len() - 1;
            if laid[newest].trials >= MAX_TRIALS {
                laid.pop();
                continue;
            }
            if tries == MAX_TRIES {
                return Err(MapError::NoMap { seed, tries });
            }
            tries += 1;
            if sample(&mut laid) {
                break;
            }
        }
    }
    Ok(laid)
}

/// Draws the next block: kind, socket, seed.
fn draw(stream: &mut Stream, plan: &BlockPlan, laid: &mut Vec<Laid>) {
    let kind = match plan {
        BlockPlan::Random(_) => {
            let weights = BlockKind::WEIGHTS.map(|(_, weight)| weight);
            BlockKind::WEIGHTS[stream.weighted(&weights)].0
        }
        BlockPlan::Sequence(kinds) => kinds[laid.len() - 1],
    };
    let before = laid.len() - 1;
    let draft = &mut laid[before].draft;
    let choice = stream.below(draft.sockets.len() as u32) as usize;
    let socket = draft.sockets[choice];
    // The road that comes in from the next block is no longer an entry.
    draft
        .traffic_entries
        .retain(|&road| road != socket.positive.opposite());
    let seed = u64::from(stream.below(BLOCK_SEEDS));
    let mut own = Stream::new(seed);
    // The block is sampled once when it is made; that sample is never used.
    own.skip_parameters();
    laid.push(Laid {
        kind,
        seed,
        trials: 0,
        parameters: Parameters::Fixed,
        entry: Some(socket.number),
        draft: Draft::default(),
        stream: Some(own),
    });
}

/// Samples the newest block once; whether it fits.
fn sample(laid: &mut [Laid]) -> bool {
    let Some((newest, earlier)) = laid.split_last_mut() else {
        return false;
    };
    let (Some(stream), Some(entry)) = (&mut newest.stream, entry_of(newest.entry, earlier)) else {
        return false;
    };
    newest.trials += 1;
    newest.parameters = Parameters::sample(newest.kind, stream.parameters());
    let around: Vec<&Draft> = earlier.iter().map(|block| &block.draft).collect();
    let index = earlier.len() as u16;
    let builder = Builder::new((index, newest.kind), &entry, &around);
    match newest.parameters.build(builder) {
        Ok(draft) => {
            newest.draft = draft;
            true
        }
        Err(_) => {
            newest.draft = Draft::default();
            false
        }
    }
}

/// The road that a block continues.
fn entry_of(number: Option<u8>, earlier: &[Laid]) -> Option<Entry> {
    let draft = &earlier.last()?.draft;
    let socket = draft.sockets.iter().find(|s| Some(s.number) == number)?;
    let road = draft
        .roads
        .iter()
        .find(|road| road.name == socket.positive)?;
    Some(Entry {
        positive: road.name,
        lanes: road.lanes.clone(),
    })
}
