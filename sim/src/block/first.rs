//! The first block: ten metres to spawn on, and a straight road to its socket.

use vehicle::Point;

use super::BlockKind;
use super::builder::{Builder, Draft, Entry, Lines, RoadName, extended};
use crate::lane::{Lane, LineType};
use crate::road::{Direction, NodeName};

/// Length of the road on which an episode begins, m (`ENTRANCE_LENGTH`).
pub(crate) const ENTRANCE_M: f64 = 10.0;

/// The first block is attached to nothing.
static NOWHERE: Entry = Entry {
    positive: RoadName {
        from: NODE,
        to: NODE,
    },
    lanes: Vec::new(),
};
const NODE: NodeName = NodeName {
    direction: Direction::Outbound,
    block: 0,
    kind: BlockKind::First,
    part: 0,
    number: 0,
};

/// Builds it from the origin along world x; the rightmost lane is at y = 0.
pub(super) fn build(lane_count: usize, lane_width_m: f64, exit_length_m: f64) -> Draft {
    let spawn_lane = Lane::straight(Point::origin(), Point::new(ENTRANCE_M, 0.0), lane_width_m);
    let mut builder = Builder::new((0, BlockKind::First), &NOWHERE, &[]);
    let nodes = [0, 1, 2].map(|number| builder.node(0, number));
    let ahead = extended(
        &spawn_lane,
        exit_length_m - ENTRANCE_M,
        [LineType::Broken, LineType::Side],
    );
    let spawn_road = RoadName {
        from: nodes[0],
        to: nodes[1],
    };
    let socket_road = RoadName {
        from: nodes[1],
        to: nodes[2],
    };
    for (lane, road) in [(spawn_lane, spawn_road), (ahead, socket_road)] {
        // Without other blocks there is no overlap.
        let _ = builder.place(lane, lane_count, road, Lines::ROAD);
        let _ = builder.place_opposite(road, Lines::ROAD);
    }
    builder.add_socket(socket_road);
    builder.finish()
}
