//! What a car is: frames, poses, the kinematic bicycle, limits, footprint and scanner.
//! Arithmetic only; no I/O, no clock, no allocation. Without the feature `std` the
//! crate needs no operating system; the feature `libm` then gives the mathematics.
//!
//! # Frames and signs of the whole repository
//!
//! | frame | origin | axes |
//! |---|---|---|
//! | `world` | fixed at the start of an episode | x, y in the ground plane |
//! | `body` | centre of the car's footprint | x forward, y **left** |
//! | `road` | the car's projection onto its reference lane | x along the lane, y **left** |
//!
//! Headings and steering angles are counter-clockwise: positive turns left.
//! Lengths are metres, angles radians, speeds m/s, time nanoseconds or seconds
//! as the name says. A name begins with the frame it is in and ends with its
//! unit: `goal_body`, `speed_mps`. A pose is named for what it maps:
//! `world_from_body * goal_body` gives `goal_world`, and
//! `road_from_world * world_from_body` chains where the inner names agree.
//!
//! A normalised [`Action`] is (`steer`, `pedal`), both in [-1, 1]; positive
//! steers left, positive pedal drives, negative brakes.
//!
//! ```
//! use vehicle::{Action, State, Vehicle, step};
//!
//! let car = Vehicle::default();
//! let left = Action { steer: 1.0, pedal: 0.0 };
//! let state = step(&car, &State::at_origin(5.0), left.control(&car), 0.1);
//! assert!(state.position.x > 0.49 && state.heading_rad > 0.0);
//! ```

#![cfg_attr(not(feature = "std"), no_std)]

#[cfg(not(any(feature = "std", feature = "libm")))]
compile_error!("vehicle: enable the feature `std`, or `libm` without a standard library");

/// The mathematics that `core` does not have: with the feature `std` the host's C
/// library, bit by bit, else the crate libm, whose last bits may differ. A file of a
/// crate without `std` imports it by `use vehicle::Float as _`; where another crate
/// links `std`, the methods of `f64` come first and are the same.
pub use num_traits::Float;

mod action;
mod angle;
mod bicycle;
mod footprint;
mod parameters;
mod scanner;
mod sight;

pub use action::{Action, Control};
pub use angle::{rem_euclid, wrap_rad};
pub use bicycle::{State, step};
pub use footprint::Footprint;
pub use parameters::{InvalidVehicle, Vehicle};
pub use scanner::{BEAMS_MAX, Fan, Scanner};
pub use sight::{Extent, Sight};

/// A point, metres, in the frame its name begins with.
pub type Point = nalgebra::Point2<f64>;
/// A displacement or velocity, in the frame its name begins with.
pub type Vector = nalgebra::Vector2<f64>;
/// A rigid transform of the plane; `world_from_body` is the pose of the body
/// in the world.
pub type Pose = nalgebra::Isometry2<f64>;

/// A pose from position (m) and heading (rad, counter-clockwise).
pub fn pose(x_m: f64, y_m: f64, heading_rad: f64) -> Pose {
    Pose::new(Vector::new(x_m, y_m), heading_rad)
}
