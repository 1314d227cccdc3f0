//! A straight road with a ramp on its right: one that joins it, or one that
//! leaves it.

use super::builder::{Bend, Builder, Built, Lines, RoadName, bend_and_straight, extended};
use super::{BlockKind, Overlap};
use crate::lane::{Lane, LineType, Turn};
use crate::road::NodeName;

/// Radius of the ramp's two bends, m.
const RADIUS_M: f64 = 40.0;
/// Angle of the ramp's two bends, degrees.
const ANGLE_DEG: f64 = 10.0;
/// Length of the straight between the bends, m.
const CONNECT_M: f64 = 20.0;
/// Length of the straight at the far end of the ramp, m.
const RAMP_M: f64 = 15.0;
/// Main road before the ramp's far end (in) and behind it (out), m.
const EXTRA_IN_M: f64 = 10.0;
const EXTRA_OUT_M: f64 = 15.0;
/// Main road behind the place where the ramp has joined, m.
const SOCKET_M: f64 = 20.0;
/// Where the ramp's overlap is checked, in half widths to the right.
const CHECK: f64 = 0.95;

/// The sampled lengths.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lengths {
    /// Length of the acceleration or deceleration lane, m.
    pub length_m: f64,
    /// Length over which that lane opens or closes, m.
    pub extension_m: f64,
}

/// Builds a ramp in or out, by the kind of the block.
pub(super) fn build(out: &mut Builder<'_>, lengths: Lengths) -> Built {
    match out.kind {
        BlockKind::InRamp => build_in(out, lengths),
        _ => build_out(out, lengths),
    }
}

fn build_in(out: &mut Builder<'_>, lengths: Lengths) -> Built {
    let count = out.lane_count();
    let left_line = left_line(count);
    let before = RoadName {
        from: out.entry.positive.to,
        to: out.node(0, 0),
    };
    let lane = extended(
        &out.basic_lane(),
        ramp_reach_m() + EXTRA_IN_M,
        [LineType::Broken, LineType::Continuous],
    );
    place_pair(out, lane, before)?;
    out.set_right_lines(before, [left_line, LineType::Continuous]);
    let before_lane = out.rightmost(before);
    out.set_right_lines(before.opposite(), [outer_line(count), LineType::Side]);

    let beside = RoadName {
        from: before.to,
        to: out.node(0, 1),
    };
    place_beside(out, &before_lane, beside, lengths)?;

    let after = RoadName {
        from: beside.to,
        to: out.node(0, 2),
    };
    let lane = extended(&out.rightmost(beside), SOCKET_M, [LineType::Broken; 2]);
    place_pair(out, lane, after)?;
    out.add_socket(after);
    build_joining(out, (before_lane, beside), lengths)
}

/// The ramp itself, from its far end to where its lane has closed.
fn build_joining(
    out: &mut Builder<'_>,
    (before_lane, beside): (Lane, RoadName),
    lengths: Lengths,
) -> Built {
    let width_m = before_lane.width_m;
    let right_m = ramp_offset_m() + width_m;
    let mut far = Lane::straight(
        before_lane.position(EXTRA_IN_M, right_m),
        before_lane.position(EXTRA_IN_M + RAMP_M, right_m),
        width_m,
    );
    far.lines = [LineType::Continuous; 2];
    let far_road = RoadName {
        from: out.node(1, 0),
        to: out.node(1, 1),
    };
    add_checked(out, far_road, far)?;
    out.out.traffic_entries.push(far_road);

    let (bend, connect) = ramp_bend(&far, Turn::Left, CONNECT_M);
    let (last_bend, mut joining) = ramp_bend(&connect, Turn::Right, lengths.length_m);
    let nodes = [far_road.to, out.node(1, 2), out.node(1, 3), beside.from];
    add_chain(out, nodes, [bend, connect, last_bend])?;

    joining.lines = [LineType::None, LineType::Continuous];
    let joining_road = RoadName {
        from: beside.from,
        to: out.node(1, 4),
    };
    add_checked(out, joining_road, joining)?;
    let closing = Lane::taper(
        joining.end_world,
        joining.position(joining.length_m + lengths.extension_m, -width_m),
        width_m,
    );
    let closing_road = RoadName {
        from: joining_road.to,
        to: beside.to,
    };
    out.add_lane(closing_road, closing);
    Ok(())
}

fn build_out(out: &mut Builder<'_>, lengths: Lengths) -> Built {
    let count = out.lane_count();
    let left_line = left_line(count);
    let beside = RoadName {
        from: out.entry.positive.to,
        to: out.node(0, 0),
    };
    let entry = out.basic_lane();
    place_beside(out, &entry, beside, lengths)?;

    let after = RoadName {
        from: beside.to,
        to: out.node(0, 1),
    };
    let beside_lane = out.rightmost(beside);
    let lane = extended(
        &beside_lane,
        ramp_reach_m() + EXTRA_OUT_M,
        [left_line, LineType::Continuous],
    );
    place_pair(out, lane, after)?;
    out.set_right_lines(after.opposite(), [outer_line(count), LineType::Side]);
    out.add_socket(after);
    build_leaving(out, (beside_lane, beside), lengths)
}

/// The ramp itself, from where its lane opens to its far end.
fn build_leaving(
    out: &mut Builder<'_>,
    (beside_lane, beside): (Lane, RoadName),
    lengths: Lengths,
) -> Built {
    let width_m = beside_lane.width_m;
    let opening = Lane::taper(
        beside_lane.position(0.0, 0.0),
        beside_lane.position(lengths.extension_m, width_m),
        width_m,
    );
    let opening_road = RoadName {
        from: beside.from,
        to: out.node(1, 0),
    };
    out.add_lane(opening_road, opening);
    let mut leaving = Lane::straight(
        opening.end_world,
        beside_lane.position(beside_lane.length_m, width_m),
        width_m,
    );
    leaving.lines = [LineType::None, LineType::Continuous];
    let leaving_road = RoadName {
        from: opening_road.to,
        to: beside.to,
    };
    add_checked(out, leaving_road, leaving)?;

    let (bend, connect) = ramp_bend(&leaving, Turn::Right, CONNECT_M);
    let (last_bend, far) = ramp_bend(&connect, Turn::Left, RAMP_M);
    let nodes = [beside.to, out.node(1, 1), out.node(1, 2), out.node(1, 3)];
    add_chain(out, nodes, [bend, connect, last_bend])?;
    let far_road = RoadName {
        from: nodes[3],
        to: out.node(1, 4),
    };
    add_checked(out, far_road, far)
}

/// The stretch of main road beside the ramp's own lane, after a lane.
fn place_beside(out: &mut Builder<'_>, after: &Lane, road: RoadName, lengths: Lengths) -> Built {
    let lane = extended(
        after,
        lengths.length_m + lengths.extension_m,
        [LineType::Broken, LineType::Side],
    );
    place_pair(out, lane, road)?;
    out.set_right_lines(road, [left_line(out.lane_count()), LineType::Broken]);
    Ok(())
}

/// A stretch of main road and its opposite direction.
fn place_pair(out: &mut Builder<'_>, lane: Lane, road: RoadName) -> Built {
    out.place(lane, out.lane_count(), road, Lines::RAMP)?;
    out.place_opposite(road, Lines::ROAD)
}

fn add_chain(out: &mut Builder<'_>, nodes: [NodeName; 4], lanes: [Lane; 3]) -> Built {
    for (ends, lane) in nodes.windows(2).zip(lanes) {
        let road = RoadName {
            from: ends[0],
            to: ends[1],
        };
        add_checked(out, road, lane)?;
    }
    Ok(())
}

fn add_checked(out: &mut Builder<'_>, road: RoadName, lane: Lane) -> Result<(), Overlap> {
    out.check(&lane, CHECK)?;
    out.add_lane(road, lane);
    Ok(())
}

/// One of the ramp's bends and the straight after it.
fn ramp_bend(lane: &Lane, turn: Turn, straight_m: f64) -> (Lane, Lane) {
    let bend = Bend {
        radius_m: RADIUS_M,
        angle_rad: ANGLE_DEG.to_radians(),
        turn,
    };
    let (mut arc, mut straight) = bend_and_straight(lane, bend, straight_m);
    arc.lines = [LineType::Continuous; 2];
    straight.lines = [LineType::Continuous; 2];
    (arc, straight)
}

/// Length of the ramp along the main road, m.
fn ramp_reach_m() -> f64 {
    let (sin, cos) = ANGLE_DEG.to_radians().sin_cos();
    sin * RADIUS_M * 2.0 + cos * CONNECT_M + RAMP_M
}

/// How far the far end of the ramp is beside its lane at the main road, m.
fn ramp_offset_m() -> f64 {
    let (sin, cos) = ANGLE_DEG.to_radians().sin_cos();
    (1.0 - cos) * RADIUS_M * 2.0 + sin * CONNECT_M
}

/// The left line of the rightmost lane beside a ramp.
fn left_line(lane_count: usize) -> LineType {
    match lane_count {
        1 => LineType::Continuous,
        _ => LineType::Broken,
    }
}

/// The left line of the rightmost lane opposite a ramp.
fn outer_line(lane_count: usize) -> LineType {
    match lane_count {
        1 => LineType::None,
        _ => LineType::Broken,
    }
}
