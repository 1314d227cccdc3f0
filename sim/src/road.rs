//! The road network of a map: nodes, roads between them, and their lanes, in
//! flat arrays with integer ids. Names exist for drawings and comparisons
//! only. Source: `component/road_network/node_road_network.py` of MetaDrive.

use std::collections::VecDeque;
use std::fmt;
use std::ops::Range;

use crate::lane::{LANE_BYTES, Lane};
use crate::map::BlockKind;
use crate::prefetch;
use crate::surface::Bounds;

/// A lane that ends nearer than this to the start of another leads to it, m.
const JOIN_M: f64 = 0.1;

/// Most lanes that begin or end at one place: those of a crossing are four.
const JOINED: usize = 6;
/// The id of no lane: no map has so many.
const NO_LANE: LaneId = LaneId(u16::MAX);

macro_rules! id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub u16);

        impl $name {
            /// Position in the network's array.
            pub fn index(self) -> usize {
                usize::from(self.0)
            }

            pub(crate) fn from_index(index: usize) -> $name {
                // Generation refuses maps whose lanes would not fit.
                $name(u16::try_from(index).unwrap_or(u16::MAX))
            }
        }
    };
}

id!(
    /// A node, where roads begin and end.
    NodeId
);
id!(
    /// A road, the lanes from one node to another.
    RoadId
);
id!(
    /// A lane. The lanes of a road have consecutive ids, left to right.
    LaneId
);

/// Which of the two directions of a road pair a node belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Direction {
    /// Away from the first block.
    Outbound,
    /// Back towards it; MetaDrive writes a minus before the name.
    Inbound,
}

/// A node's name, as MetaDrive writes it: `>`, `1S0_0_`, `-2X1_0_`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct NodeName {
    /// Which direction it belongs to.
    pub direction: Direction,
    /// Index of the block that made it.
    pub block: u16,
    /// Kind of that block.
    pub kind: BlockKind,
    /// Part of the block.
    pub part: u8,
    /// Number within the part.
    pub number: u8,
}

impl NodeName {
    /// The node of the opposite direction at the same place.
    pub fn opposite(self) -> NodeName {
        let direction = match self.direction {
            Direction::Outbound => Direction::Inbound,
            Direction::Inbound => Direction::Outbound,
        };
        NodeName { direction, ..self }
    }
}

impl fmt::Display for NodeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.direction == Direction::Inbound {
            f.write_str("-")?;
        }
        if self.kind == BlockKind::First {
            return f.write_str(&">>>"[..=usize::from(self.number.min(2))]);
        }
        let letter = self.kind.letter();
        write!(f, "{}{letter}{}_{}_", self.block, self.part, self.number)
    }
}

/// The lanes from one node to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Road {
    /// Where it begins.
    pub from: NodeId,
    /// Where it ends.
    pub to: NodeId,
    /// Its leftmost lane.
    pub first_lane: LaneId,
    /// Number of lanes.
    pub lane_count: u16,
}

impl Road {
    /// Its rightmost lane.
    pub fn last_lane(&self) -> LaneId {
        LaneId(self.first_lane.0 + self.lane_count - 1)
    }
}

/// The lanes around the ends of a lane. Every driver compares them with those of all
/// bodies around it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Joins {
    /// Lanes that begin where it ends.
    next: [LaneId; JOINED],
    /// Lanes that end where it begins.
    before: [LaneId; JOINED],
    /// A bit for each of these lanes and for the lane itself, by the last digits of its id.
    marks: u64,
}

impl Joins {
    const NONE: Joins = Joins {
        next: [NO_LANE; JOINED],
        before: [NO_LANE; JOINED],
        marks: 0,
    };

    /// Whether a lane may be one of these or the lane itself; false only if it is not.
    #[inline(always)]
    pub fn may_hold(&self, lane: LaneId) -> bool {
        self.marks & mark(lane) != 0
    }

    /// Whether this lane ends where another begins.
    pub fn leads_to(&self, lane: LaneId) -> bool {
        self.next.contains(&lane)
    }

    /// Whether this lane begins where another ends.
    pub fn follows(&self, lane: LaneId) -> bool {
        self.before.contains(&lane)
    }
}

/// All roads of a map.
#[derive(Clone, Debug, Default)]
pub struct Network {
    nodes: Vec<NodeName>,
    /// Grouped by the node they begin at.
    roads: Vec<Road>,
    /// For each node, its range in `roads`.
    roads_from: Vec<Range<u16>>,
    lanes: Vec<Lane>,
    lane_roads: Vec<RoadId>,
    bounds: Vec<Bounds>,
    joins: Vec<Joins>,
}

impl Network {
    /// Builds the arrays from roads in the order in which they were made.
    /// Roads from the same node keep their order and come together.
    pub(crate) fn new<'a>(
        drafts: impl Iterator<Item = (NodeName, NodeName, &'a [Lane])> + Clone,
    ) -> Network {
        let mut network = Network::default();
        for (from, _, _) in drafts.clone() {
            network.intern(from);
        }
        let begins = network.nodes.len();
        for (_, to, _) in drafts.clone() {
            network.intern(to);
        }
        let mut by_origin: Vec<Vec<(NodeName, &[Lane])>> = vec![Vec::new(); begins];
        for (from, to, lanes) in drafts {
            let origin = network.intern(from);
            by_origin[origin.index()].push((to, lanes));
        }
        for (origin, roads) in by_origin.into_iter().enumerate() {
            let first = RoadId::from_index(network.roads.len()).0;
            for (to, lanes) in roads {
                network.push_road(NodeId::from_index(origin), to, lanes);
            }
            let end = RoadId::from_index(network.roads.len()).0;
            network.roads_from.push(first..end);
        }
        let end = RoadId::from_index(network.roads.len()).0;
        network.roads_from.resize(network.nodes.len(), end..end);
        network.join();
        network
    }

    fn intern(&mut self, name: NodeName) -> NodeId {
        let index = self
            .nodes
            .iter()
            .position(|&known| known == name)
            .unwrap_or_else(|| {
                self.nodes.push(name);
                self.nodes.len() - 1
            });
        NodeId::from_index(index)
    }

    fn push_road(&mut self, from: NodeId, to: NodeName, lanes: &[Lane]) {
        let to = self.intern(to);
        let road = RoadId::from_index(self.roads.len());
        self.roads.push(Road {
            from,
            to,
            first_lane: LaneId::from_index(self.lanes.len()),
            lane_count: lanes.len() as u16,
        });
        for lane in lanes {
            self.lanes.push(*lane);
            self.lane_roads.push(road);
            self.bounds.push(lane.surface_bounds());
        }
    }

    /// Finds the lanes that lead to each other.
    fn join(&mut self) {
        let mut starts: Vec<LaneId> = (0..self.lanes.len()).map(LaneId::from_index).collect();
        let x_m = |lane: LaneId| self.lanes[lane.index()].start_world.x;
        starts.sort_unstable_by(|&a, &b| x_m(a).total_cmp(&x_m(b)));
        let mut joins = vec![Joins::NONE; self.lanes.len()];
        for (index, lane) in self.lanes.iter().enumerate() {
            let own = LaneId::from_index(index);
            joins[index].marks |= mark(own);
            let end_world = lane.end_world;
            // Twice the distance, so that rounding leaves out no lane.
            let first = starts.partition_point(|&next| x_m(next) < end_world.x - 2.0 * JOIN_M);
            let near = starts[first..]
                .iter()
                .take_while(|&&next| x_m(next) <= end_world.x + 2.0 * JOIN_M);
            for &next in near {
                let start_world = self.lanes[next.index()].start_world;
                if (end_world - start_world).norm_squared() < JOIN_M * JOIN_M {
                    note(&mut joins[index].next, next);
                    note(&mut joins[next.index()].before, own);
                    joins[index].marks |= mark(next);
                    joins[next.index()].marks |= mark(own);
                }
            }
        }
        self.joins = joins;
    }

    /// All nodes' names, by id.
    pub fn nodes(&self) -> &[NodeName] {
        &self.nodes
    }

    /// All roads, by id.
    pub fn roads(&self) -> &[Road] {
        &self.roads
    }

    /// All lanes, by id.
    pub fn lanes(&self) -> &[Lane] {
        &self.lanes
    }

    /// The upright boxes around the lanes' surfaces, by lane id.
    pub fn bounds(&self) -> &[Bounds] {
        &self.bounds
    }

    /// One road. Ids come from this network and are always valid.
    pub fn road(&self, road: RoadId) -> &Road {
        &self.roads[road.index()]
    }

    /// One lane.
    pub fn lane(&self, lane: LaneId) -> &Lane {
        &self.lanes[lane.index()]
    }

    /// The lanes of a road, left to right.
    pub fn lanes_of(&self, road: RoadId) -> &[Lane] {
        let road = self.road(road);
        let first = road.first_lane.index();
        &self.lanes[first..first + usize::from(road.lane_count)]
    }

    /// The ids of the lanes of a road, left to right.
    pub fn lane_ids(&self, road: RoadId) -> impl DoubleEndedIterator<Item = LaneId> + use<> {
        let road = *self.road(road);
        (road.first_lane.0..road.first_lane.0 + road.lane_count).map(LaneId)
    }

    /// The road that a lane is part of.
    pub fn road_of(&self, lane: LaneId) -> RoadId {
        self.lane_roads[lane.index()]
    }

    /// Whether one lane ends where another begins.
    pub fn leads_to(&self, lane: LaneId, next: LaneId) -> bool {
        self.joins(lane).leads_to(next)
    }

    /// Asks for what a driver on a lane reads of it.
    pub(crate) fn prefetch_lane(&self, lane: LaneId) {
        let index = lane.index();
        prefetch::first::<LANE_BYTES, _>(&self.lanes[index]);
        prefetch::value(&self.joins[index]);
        prefetch::value(&self.lane_roads[index]);
    }

    /// Asks for a road.
    pub(crate) fn prefetch_road(&self, road: RoadId) {
        prefetch::value(self.road(road));
    }

    /// The lanes that lead to a lane, and those that it leads to.
    pub(crate) fn joins(&self, lane: LaneId) -> &Joins {
        &self.joins[lane.index()]
    }

    /// A lane's place in its road: 0 is the leftmost.
    pub fn index_in_road(&self, lane: LaneId) -> u16 {
        lane.0 - self.road(self.road_of(lane)).first_lane.0
    }

    /// The roads that begin at a node.
    pub fn roads_from(&self, node: NodeId) -> impl Iterator<Item = RoadId> + use<> {
        self.roads_from[node.index()].clone().map(RoadId)
    }

    /// The road from one node to another, if there is one.
    pub fn road_between(&self, from: NodeId, to: NodeId) -> Option<RoadId> {
        self.roads_from(from).find(|&road| self.road(road).to == to)
    }

    /// The node of that name.
    pub fn node(&self, name: NodeName) -> Option<NodeId> {
        let index = self.nodes.iter().position(|&known| known == name)?;
        Some(NodeId::from_index(index))
    }

    /// A road's name as MetaDrive's dumps write it: `from|to`.
    pub fn road_name(&self, road: RoadId) -> String {
        let road = self.road(road);
        let (from, to) = (self.nodes[road.from.index()], self.nodes[road.to.index()]);
        format!("{from}|{to}")
    }

    /// The roads from `start` to `goal` with the fewest roads, or `None` if
    /// there is no way (or no way is needed).
    pub fn route(&self, start: NodeId, goal: NodeId) -> Option<Vec<RoadId>> {
        let mut reached_by: Vec<Option<RoadId>> = vec![None; self.nodes.len()];
        let mut queue = VecDeque::from([start]);
        while let Some(node) = queue.pop_front() {
            for road in self.roads_from(node) {
                let next = self.road(road).to;
                if next == start || reached_by[next.index()].is_some() {
                    continue;
                }
                reached_by[next.index()] = Some(road);
                if next == goal {
                    return Some(self.trace_back(goal, &reached_by));
                }
                queue.push_back(next);
            }
        }
        None
    }

    fn trace_back(&self, goal: NodeId, reached_by: &[Option<RoadId>]) -> Vec<RoadId> {
        let mut roads = Vec::new();
        let mut node = goal;
        while let Some(road) = reached_by[node.index()] {
            roads.push(road);
            node = self.road(road).from;
        }
        roads.reverse();
        roads
    }
}

/// The bit of a lane.
fn mark(lane: LaneId) -> u64 {
    1 << (lane.0 % 64)
}

/// Adds a lane where there is room for one. At no place of a map do more begin or end.
fn note(lanes: &mut [LaneId; JOINED], lane: LaneId) {
    let room = lanes.iter_mut().find(|known| **known == NO_LANE);
    debug_assert!(room.is_some(), "more than {JOINED} lanes at one place");
    if let Some(room) = room {
        *room = lane;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::{BlockPlan, Map, MapConfig};

    #[test]
    fn joined_lanes_are_those_whose_ends_meet() {
        let mut met = 0;
        for seed in 0..30 {
            let config = MapConfig {
                blocks: BlockPlan::Random(6),
                lane_count: 1 + seed as usize % 5,
                ..MapConfig::default()
            };
            let Ok(map) = Map::generate(&config, seed) else {
                continue;
            };
            let network = &map.network;
            let lanes = network.lanes();
            for (a, lane) in lanes.iter().enumerate() {
                for (b, next) in lanes.iter().enumerate() {
                    let apart = lane.end_world - next.start_world;
                    let meets = apart.norm_squared() < JOIN_M * JOIN_M;
                    let [a, b] = [a, b].map(LaneId::from_index);
                    assert_eq!(network.leads_to(a, b), meets, "seed {seed}: {a:?}, {b:?}");
                    assert_eq!(network.joins(b).follows(a), meets, "seed {seed}");
                    let marked = network.joins(a).may_hold(b) && network.joins(b).may_hold(a);
                    assert!(marked || !(meets || a == b), "seed {seed}: {a:?}, {b:?}");
                    met += usize::from(meets);
                }
            }
        }
        assert!(met > 1000, "{met} lanes meet");
    }
}
