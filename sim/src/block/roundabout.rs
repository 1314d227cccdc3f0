//! A roundabout of four arms.
//!
//! Each quarter is: a right bend into the ring, a piece of ring to the left,
//! a right bend out of it with the arm behind, and a piece of ring that
//! passes the exit and reaches the next quarter.

use super::builder::{Bend, Builder, Built, Lines, RoadName, bend_and_straight, rightmost};
use crate::lane::{Lane, LineType, Turn};

/// Angle of the bends, degrees.
const ANGLE_DEG: f64 = 60.0;
/// Length of an arm, m (`EXIT_PART_LENGTH`).
const ARM_M: f64 = 35.0;

/// The sampled radii.
#[derive(Clone, Copy, Debug)]
pub(super) struct Radii {
    /// Radius of the bends into and out of the ring, m.
    pub exit_m: f64,
    /// Radius of the ring's inner edge, m.
    pub inner_m: f64,
}

pub(super) fn build(out: &mut Builder<'_>, radii: Radii) -> Built {
    let mut entry = out.entry.positive;
    let mut lane = out.basic_lane();
    for part in 0..4 {
        let exit = build_quarter(out, (part, entry, lane), radii)?;
        if part < 3 {
            out.place_opposite(exit, Lines::ROAD)?;
            entry = exit.opposite();
            lane = rightmost(out.lanes(entry));
        }
    }
    let entries: Vec<RoadName> = out
        .out
        .sockets
        .iter()
        .map(|s| s.positive.opposite())
        .collect();
    out.out.traffic_entries = entries;
    Ok(())
}

/// One quarter; returns its arm, which the last quarter does not have.
fn build_quarter(
    out: &mut Builder<'_>,
    (part, entry, lane): (u8, RoadName, Lane),
    radii: Radii,
) -> Result<RoadName, super::Overlap> {
    let count = out.lane_count();
    let width_m = lane.width_m;
    let across_m = (2 * count - 1) as f64 * width_m;
    let right = Bend {
        radius_m: radii.exit_m,
        angle_rad: ANGLE_DEG.to_radians(),
        turn: Turn::Right,
    };

    let (bend, after) = bend_and_straight(&lane, right, 10.0);
    let enter = RoadName {
        from: entry.to,
        to: out.node(part, 0),
    };
    out.place(bend, count, enter, Lines::ROAD)?;
    leave_edge_only(out.lanes(enter));

    let around = Bend {
        radius_m: across_m + radii.inner_m,
        angle_rad: (2.0 * ANGLE_DEG - 90.0).to_radians(),
        turn: Turn::Left,
    };
    let (bend, after) = bend_and_straight(&run_up(&after, 5.0), around, 10.0);
    let ring = RoadName {
        from: enter.to,
        to: out.node(part, 1),
    };
    out.place(bend, count, ring, Lines::ROAD)?;
    out.out.ring.push(ring);

    let (bend, arm_lane) = bend_and_straight(&run_up(&after, 5.0), right, ARM_M);
    let leave = RoadName {
        from: ring.to,
        to: if part < 3 {
            out.node(part, 2)
        } else {
            out.entry.positive.opposite().from
        },
    };
    out.place(bend, count, leave, Lines::ROAD)?;
    leave_edge_only(out.lanes(leave));
    let arm = RoadName {
        from: leave.to,
        to: out.node(part, 3),
    };
    if part < 3 {
        out.place(arm_lane, count, arm, Lines::ROAD)?;
        out.add_socket(arm);
    }

    let pass = pass_exit(&after, across_m, radii.exit_m);
    let past = RoadName {
        from: ring.to,
        to: out.node((part + 1) % 4, 0),
    };
    out.lay(
        pass,
        count,
        (past, super::builder::Toward::Left),
        Lines::ROAD,
    )?;
    mark_inside(out.lanes(past));
    Ok(arm)
}

/// The rightmost lane of the piece of ring that passes an exit.
fn pass_exit(after_ring: &Lane, across_m: f64, exit_radius_m: f64) -> Lane {
    let beneath_m = across_m / 2.0 + exit_radius_m;
    let bend = Bend {
        radius_m: beneath_m / ANGLE_DEG.to_radians().cos() - exit_radius_m,
        angle_rad: (180.0 - 2.0 * ANGLE_DEG).to_radians(),
        turn: Turn::Left,
    };
    bend_and_straight(&run_up(after_ring, 6.0), bend, 5.0).0
}

/// A short lane that ends where another begins; a bend can continue it.
fn run_up(lane: &Lane, length_m: f64) -> Lane {
    Lane::straight(
        lane.position(-length_m, 0.0),
        lane.position(0.0, 0.0),
        lane.width_m,
    )
}

/// Lines at the outer edge only.
fn leave_edge_only(lanes: &mut [Lane]) {
    for lane in lanes.iter_mut() {
        lane.lines = [LineType::None; 2];
    }
    if let Some(lane) = lanes.last_mut() {
        lane.lines[1] = LineType::Side;
    }
}

/// Lines between the lanes, and a solid one around the island.
fn mark_inside(lanes: &mut [Lane]) {
    let inner = match lanes.len() {
        1 => LineType::None,
        _ => LineType::Broken,
    };
    for lane in lanes.iter_mut() {
        lane.lines = [LineType::Broken; 2];
    }
    if let Some(lane) = lanes.first_mut() {
        lane.lines = [LineType::Continuous, inner];
    }
}
