//! The policy's input as the networks get it.
//!
//! MetaDrive's features lie in [0, 1], most of them in a small part of it; a free
//! beam is 1. The networks learn faster from numbers around zero and beams that
//! are 0 where there is nothing. The change is linear, so it is folded into the
//! first layer when a policy is written: its file takes the plain features.

use shm_config::message::FEATURES;

use crate::replay::ACTIONS;

/// Features before the beams.
const EGO: usize = 19;
/// The ego's features are centred and stretched by this.
const STRETCH: f32 = 4.0;
/// First features of the two checkpoints.
const CHECKPOINTS: [usize; 2] = [9, 14];
/// Widths are divided by this, m.
const WIDTH_M: f32 = 18.0;
/// Radii are divided by this, m.
const RADIUS_M: f32 = 70.5;
/// Width of a lane, m.
const LANE_M: f32 = 3.5;

/// `x' = scale x + shift` of a feature.
pub const fn scaling(feature: usize) -> (f32, f32) {
    match feature < EGO {
        true => (STRETCH, -0.5 * STRETCH),
        false => (-1.0, 1.0),
    }
}

/// Plain features become the networks' input, in place.
pub fn prepare(row: &mut [f32]) {
    for (feature, value) in row.iter_mut().enumerate() {
        let (scale, shift) = scaling(feature);
        *value = scale * *value + shift;
    }
}

/// Plain features of the same scene seen in a mirror, in place: what is left is
/// right. The action's steering turns with it.
///
/// A bend's radius is that of the leftmost lane, which is the rightmost one in
/// the mirror.
pub fn mirror(row: &mut [f32; FEATURES]) {
    let width_m = (row[0] + row[1]) * WIDTH_M;
    row.swap(0, 1);
    // Heading, both steerings, and the offset from the lane's centre.
    for feature in [2, 4, 5, 8] {
        row[feature] = 1.0 - row[feature];
    }
    let across = (width_m - LANE_M).max(0.0) / RADIUS_M;
    for first in CHECKPOINTS {
        row[first + 1] = 1.0 - row[first + 1];
        let (radius, bend) = (row[first + 2], row[first + 3]);
        // 0 is a bend to the left, 1 one to the right, 0.5 none.
        row[first + 2] = if bend == 0.0 {
            (radius + across).min(1.0)
        } else if bend == 1.0 {
            (radius - across).max(0.0)
        } else {
            radius
        };
        row[first + 3] = 1.0 - bend;
    }
    // Beam 0 looks ahead; the others change sides.
    row[EGO + 1..].reverse();
}

/// The action in the mirror.
pub fn mirror_action(action: &mut [f32; ACTIONS]) {
    action[0] = -action[0];
}
