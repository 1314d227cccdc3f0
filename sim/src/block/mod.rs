//! The building blocks of a map, each in its own file, and what they share: building
//! roads from one lane, adding an opposite direction, and finding overlaps with earlier
//! blocks.
//!
//! Source: `component/pgblock/*.py` of MetaDrive, commit c29cc37.

mod builder;
mod curve;
mod first;
mod intersection;
mod overlap;
mod ramp;
mod roundabout;
mod straight;

pub(crate) use builder::{Builder, Draft, Entry, RoadName};
pub(crate) use overlap::Overlap;

use crate::lane::Turn;
use crate::rng::Shared;

/// The kinds of block.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BlockKind {
    /// The two straight roads on which an episode begins; always first.
    First,
    /// A straight road.
    Straight,
    /// A bend and a straight road.
    Curve,
    /// A straight road joined by a ramp from the right.
    InRamp,
    /// A straight road that a ramp leaves to the right.
    OutRamp,
    /// A crossing of four arms.
    Intersection,
    /// A crossing with one arm missing.
    TIntersection,
    /// A roundabout of four arms.
    Roundabout,
}

impl BlockKind {
    /// The kinds that a random map draws from, with MetaDrive's weights
    /// (`PGBlockDistConfig.BLOCK_TYPE_DISTRIBUTION_V2`), in its order.
    pub const WEIGHTS: [(BlockKind, f64); 7] = [
        (BlockKind::Curve, 0.3),
        (BlockKind::Straight, 0.1),
        (BlockKind::InRamp, 0.1),
        (BlockKind::OutRamp, 0.1),
        (BlockKind::Intersection, 0.15),
        (BlockKind::TIntersection, 0.15),
        (BlockKind::Roundabout, 0.1),
    ];

    /// MetaDrive's one-letter name.
    pub fn letter(self) -> char {
        match self {
            BlockKind::First => 'I',
            BlockKind::Straight => 'S',
            BlockKind::Curve => 'C',
            BlockKind::InRamp => 'r',
            BlockKind::OutRamp => 'R',
            BlockKind::Intersection => 'X',
            BlockKind::TIntersection => 'T',
            BlockKind::Roundabout => 'O',
        }
    }

    /// The kind with this letter, among those that a map may contain.
    pub fn from_letter(letter: char) -> Option<BlockKind> {
        BlockKind::WEIGHTS
            .iter()
            .map(|&(kind, _)| kind)
            .find(|kind| kind.letter() == letter)
    }
}

/// The sampled measures of a block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Parameters {
    /// No parameters: the first block and the four-way intersection.
    Fixed,
    /// A straight road.
    Straight {
        /// Length, m.
        length_m: f64,
    },
    /// A bend.
    Curve {
        /// Length of the straight road after the bend, m.
        length_m: f64,
        /// Radius of the rightmost lane, m.
        radius_m: f64,
        /// Angle of the bend, degrees (as sampled, single precision).
        angle_deg: f64,
        /// The side to which it bends.
        turn: Turn,
    },
    /// A ramp, in or out.
    Ramp {
        /// Length of the acceleration or deceleration lane, m.
        length_m: f64,
        /// Length over which that lane opens or closes, m.
        extension_m: f64,
    },
    /// A crossing of three arms.
    TIntersection {
        /// Which arm is missing: 0 right, 1 ahead, 2 left.
        missing: u8,
    },
    /// A roundabout.
    Roundabout {
        /// Radius of the bends into and out of the ring, m.
        exit_radius_m: f64,
        /// Radius of the innermost edge, m.
        inner_radius_m: f64,
    },
}

impl Parameters {
    /// Samples a block's parameters; ranges from `BlockParameterSpace`.
    pub(crate) fn sample(kind: BlockKind, shared: Shared) -> Parameters {
        match kind {
            BlockKind::First | BlockKind::Intersection => Parameters::Fixed,
            BlockKind::Straight => Parameters::Straight {
                length_m: shared.within(40.0, 80.0),
            },
            BlockKind::Curve => Parameters::Curve {
                length_m: shared.within(40.0, 80.0),
                radius_m: shared.within(25.0, 60.0),
                angle_deg: shared.within(45.0, 135.0),
                turn: match shared.index(2) {
                    0 => Turn::Left,
                    _ => Turn::Right,
                },
            },
            BlockKind::InRamp | BlockKind::OutRamp => Parameters::Ramp {
                length_m: shared.within(20.0, 40.0),
                extension_m: shared.within(20.0, 40.0),
            },
            BlockKind::TIntersection => Parameters::TIntersection {
                missing: shared.index(3),
            },
            BlockKind::Roundabout => Parameters::Roundabout {
                exit_radius_m: shared.within(5.0, 15.0),
                inner_radius_m: shared.within(15.0, 45.0),
            },
        }
    }

    /// Builds the block that these parameters describe.
    pub(crate) fn build(&self, mut builder: Builder<'_>) -> Result<Draft, Overlap> {
        let out = &mut builder;
        match *self {
            Parameters::Fixed => intersection::build(out)?,
            Parameters::Straight { length_m } => straight::build(out, length_m)?,
            Parameters::Curve {
                length_m,
                radius_m,
                angle_deg,
                turn,
            } => {
                let bend = builder::Bend {
                    radius_m,
                    angle_rad: angle_deg.to_radians(),
                    turn,
                };
                curve::build(out, bend, length_m)?;
            }
            Parameters::Ramp {
                length_m,
                extension_m,
            } => ramp::build(
                out,
                ramp::Lengths {
                    length_m,
                    extension_m,
                },
            )?,
            Parameters::TIntersection { missing } => intersection::build_t(out, missing)?,
            Parameters::Roundabout {
                exit_radius_m,
                inner_radius_m,
            } => {
                let radii = roundabout::Radii {
                    exit_m: exit_radius_m,
                    inner_m: inner_radius_m,
                };
                roundabout::build(out, radii)?;
            }
        }
        Ok(builder.finish())
    }
}

/// Builds the first block.
pub(crate) fn first(lane_count: usize, lane_width_m: f64, exit_length_m: f64) -> Draft {
    first::build(lane_count, lane_width_m, exit_length_m)
}
