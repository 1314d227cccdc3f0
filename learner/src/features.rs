//! The input of the networks, made from the policy's features.
//!
//! MetaDrive's features lie in [0, 1], most of them in a small part of it, and a free
//! beam is 1. The networks learn faster from standardised features, and from beams that
//! are large where something is near: a decimetre counts beside an obstacle that is passed,
//! and little far ahead. A policy file takes the plain features: it has the compression of
//! the beams, and the linear rest is folded into the layers that see them.

use policy::Compression;
use shm_config::message::{
    FEATURES, INPUTS_WITH_MOTION, MOTION_AT_REST, MOTION_SECTORS, motion_sector,
};

use crate::replay::ACTIONS;
use crate::windows::Windows;

/// Features before the beams.
const EGO: usize = 19;
/// Scale of the ego's features, after centring.
const STRETCH: f32 = 4.0;
/// A beam `x` becomes `x / (1 + 20 x)`. With the scan's range of 50 m and 2.5 m to an
/// obstacle, its closeness is half as large as at the obstacle.
pub const COMPRESSION: Compression = Compression {
    from: EGO,
    to: FEATURES,
    slope: 20.0,
};
/// The closeness of a beam at an obstacle.
const CLOSENESS: f32 = 2.0;
/// Scale of the features of motion, after centring: 5 m/s become 1.
const MOTION: f32 = 8.0;
/// Index of the first feature of each of the two checkpoints.
const CHECKPOINTS: [usize; 2] = [9, 14];
/// Widths are divided by this, m.
const WIDTH_M: f32 = 18.0;
/// Radii are divided by this, m.
const RADIUS_M: f32 = 70.5;
/// Width of a lane, m.
const LANE_M: f32 = 3.5;

/// `x' = scale x + shift` of a compressed feature.
pub const fn scaling(feature: usize) -> (f32, f32) {
    match feature {
        0..EGO => (STRETCH, -0.5 * STRETCH),
        EGO..FEATURES => (-CLOSENESS * COMPRESSION.slope, CLOSENESS),
        _ => (MOTION, -MOTION_AT_REST * MOTION),
    }
}

/// Sectors in a window of either convolution: two to each side.
const WINDOW: usize = 5;
/// Every second window of the first convolution is the middle of one of the second.
const STRIDE: usize = 2;

/// Two convolutions with so many filters each, over the 60 sectors of the scan and over how
/// bodies move in them if `inputs` has that; the ego's features are passed on.
pub fn convolutions(inputs: usize, filters: usize) -> Vec<(Windows, usize)> {
    const BEAMS: usize = FEATURES - EGO;
    let sector = |sector: usize| {
        // Round from the opposite side: the beams ahead are the last and the first of the scan.
        let round =
            (0..BEAMS).map(move |k| (k + sector * BEAMS / MOTION_SECTORS + BEAMS / 2) % BEAMS);
        let beams = round.filter(move |beam| motion_sector(*beam) == sector);
        let beams = beams.map(|beam| EGO + beam);
        let motion = [0, 1].map(|part| FEATURES + 2 * sector + part);
        beams.chain(motion.into_iter().filter(|_| inputs == INPUTS_WITH_MOTION))
    };
    let answers = |sector: usize| {
        let first = EGO + sector * filters;
        first..first + filters
    };
    let first = windows((MOTION_SECTORS, 1), sector);
    let second = windows((MOTION_SECTORS, STRIDE), answers);
    vec![(first, filters), (second, filters)]
}

/// The windows around every `stride`-th of so many places on a circle, each of which has these
/// numbers of the input.
fn windows<I: Iterator<Item = usize>>(
    (places, stride): (usize, usize),
    of_place: impl Fn(usize) -> I,
) -> Windows {
    let around = |middle: usize| {
        let first = middle + places - WINDOW / 2;
        (first..first + WINDOW).map(move |place| place % places)
    };
    let indices = (0..places).step_by(stride).flat_map(around);
    let indices: Vec<u32> = indices.flat_map(&of_place).map(|k| k as u32).collect();
    Windows {
        kept: EGO,
        window: indices.len() / places.div_ceil(stride),
        indices,
    }
}

/// Turns plain features into the networks' input, in place.
pub fn prepare(row: &mut [f32]) {
    COMPRESSION.apply(row);
    for (feature, value) in row.iter_mut().enumerate() {
        let (scale, shift) = scaling(feature);
        *value = scale * *value + shift;
    }
}

/// Mirrors the plain features of a scene, in place, and those of motion if there are any:
/// left and right are exchanged, the steering changes sign.
///
/// The radius of a bend is that of the leftmost lane, which is the rightmost lane of
/// the mirrored scene.
pub fn mirror(row: &mut [f32]) {
    let (row, motion) = row.split_at_mut(FEATURES);
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
    // Beam 0 points ahead; each other beam is exchanged with the one on the other side.
    row[EGO + 1..].reverse();
    mirror_motion(motion);
}

/// Sector 0 is ahead; each other sector is exchanged with the one on the other side.
fn mirror_motion(motion: &mut [f32]) {
    let (sectors, _) = motion.as_chunks_mut::<2>();
    if sectors.len() == MOTION_SECTORS {
        sectors[1..].reverse();
    }
    for [_, left] in sectors {
        *left = 2.0 * MOTION_AT_REST - *left;
    }
}

/// Mirrors an action.
pub fn mirror_action(action: &mut [f32; ACTIONS]) {
    action[0] = -action[0];
}
