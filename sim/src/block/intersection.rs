//! Crossings of four arms and of three.
//!
//! The arms are 0 right, 1 ahead, 2 left, and the one to which the block is attached. A
//! crossing of three arms is one of four without one arm.

use std::f64::consts::FRAC_PI_2;

use super::builder::{
    Bend, Builder, Built, DraftSocket, Lines, RoadName, Toward, bend_and_straight, extended,
    rightmost,
};
use crate::lane::{Lane, LineColor, LineType, Turn};
use crate::road::NodeName;

/// Radius of the right turns' rightmost lane, m (`Parameter.radius`).
const RADIUS_M: f64 = 10.0;
/// Length of an arm, m (`EXIT_PART_LENGTH`).
const ARM_M: f64 = 35.0;

/// Builds a crossing of four arms.
pub(super) fn build(out: &mut Builder<'_>) -> Built {
    let count = out.lane_count();
    let mut entry = out.entry.positive;
    let mut lanes = out.entry.lanes.clone();
    // The nodes to the right, ahead and left, and the arm from which the car comes;
    // they rotate with the arm that is being built.
    let mut exits = [
        out.node(0, 0),
        out.node(1, 0),
        out.node(2, 0),
        entry.opposite().from,
    ];
    for arm in 0..4 {
        let right = build_part(out, &lanes, entry, exits)?;
        exits.rotate_left(1);
        if arm == 3 {
            break;
        }
        let exit = RoadName {
            from: out.node(arm, 0),
            to: out.node(arm, 1),
        };
        out.place(right, count, exit, Lines::ROAD)?;
        out.place_opposite(exit, Lines::ROAD)?;
        out.add_socket(exit);
        out.out.traffic_entries.push(exit.opposite());
        entry = exit.opposite();
        lanes = out.lanes(entry).to_vec();
    }
    Ok(())
}

/// The three paths from one arm through the crossing; returns the rightmost lane of the
/// arm to the right.
fn build_part(
    out: &mut Builder<'_>,
    lanes: &[Lane],
    entry: RoadName,
    exits: [NodeName; 4],
) -> Result<Lane, super::Overlap> {
    let count = out.lane_count();
    let way = |to: NodeName| RoadName { from: entry.to, to };
    let Some(&left_lane) = lanes.first() else {
        return Err(super::Overlap);
    };
    let turn_left = Bend {
        radius_m: RADIUS_M + count as f64 * left_lane.width_m,
        angle_rad: FRAC_PI_2,
        turn: Turn::Left,
    };
    let (mut left_bend, _) = bend_and_straight(&left_lane, turn_left, ARM_M);
    left_bend.lines = [LineType::None; 2];
    out.lay(
        left_bend,
        count,
        (way(exits[2]), Toward::Right),
        Lines::NONE,
    )?;

    let across_m = 2.0 * RADIUS_M + (2 * count - 1) as f64 * left_lane.width_m;
    for lane in lanes {
        out.add_lane(way(exits[1]), extended(lane, across_m, [LineType::None; 2]));
    }

    let turn_right = Bend {
        radius_m: RADIUS_M,
        angle_rad: FRAC_PI_2,
        turn: Turn::Right,
    };
    let (right_bend, right_arm) = bend_and_straight(&rightmost(lanes), turn_right, ARM_M);
    out.check(&right_bend, 1.0)?;
    out.lay(
        right_bend,
        count,
        (way(exits[0]), Toward::Left),
        Lines::EDGE_ONLY,
    )?;
    Ok(right_arm)
}

/// Builds a crossing of three arms: `missing` is 0 right, 1 ahead, 2 left.
pub(super) fn build_t(out: &mut Builder<'_>, missing: u8) -> Built {
    build(out)?;
    let name = |socket: &DraftSocket| socket.positive;
    let mut arms: Vec<RoadName> = out.out.sockets.iter().map(name).collect();
    // Seen from the crossing, the arm to which it is attached leads back.
    arms.push(out.entry.positive.opposite());
    let gone = arms[usize::from(missing)];
    let next = arms[(usize::from(missing) + 1) % 4];
    let last = arms[(usize::from(missing) + 3) % 4];

    let (inner_end, outer_end) = (gone.from, gone.opposite().to);
    out.out.roads.retain(|road| {
        let touches = |node| road.name.from == node || road.name.to == node;
        !touches(inner_end) && !touches(outer_end)
    });
    out.out.sockets.retain(|socket| socket.number != missing);
    out.out
        .traffic_entries
        .retain(|&road| road != gone.opposite());

    // The road straight past the missing arm gets an edge there.
    let past = RoadName {
        from: last.opposite().to,
        to: next.from,
    };
    let back = RoadName {
        from: next.opposite().to,
        to: last.from,
    };
    for (road, edge) in [(past, LineType::Side), (back, LineType::None)] {
        let lanes = out.lanes(road);
        for lane in lanes.iter_mut() {
            lane.lines = [LineType::None; 2];
        }
        if let Some(lane) = lanes.last_mut() {
            lane.lines[1] = edge;
        }
        if let Some(lane) = lanes.first_mut() {
            lane.left_color = LineColor::Yellow;
        }
    }
    Ok(())
}
