//! What moves: the bodies that the lidar sees, and the car's own state, from scan to scan.
//!
//! A scan shows where bodies are and not how they move. [`Tracker`] tells it from the scans
//! before: the expert plans around what moves, and a policy may take it as further inputs
//! ([`Tracker::motion`]), the only memory that a policy has.
//!
//! ```
//! use shm_config::message::{MOTION_AT_REST, MOTION_FEATURES, Observation};
//! use tracker::Tracker;
//!
//! let mut tracker = Tracker::default();
//! tracker.follow(&Observation::default());
//! // Nothing is there, so nothing moves.
//! assert_eq!(tracker.motion(), [MOTION_AT_REST; MOTION_FEATURES]);
//! ```

#![cfg_attr(not(feature = "std"), no_std)]

mod beams;
#[cfg(feature = "std")]
mod body;
#[cfg(feature = "std")]
mod cluster;
#[cfg(feature = "std")]
mod ego;
#[cfg(feature = "std")]
mod kalman;
#[cfg(feature = "std")]
mod kinematic;
#[cfg(feature = "std")]
mod past;
#[cfg(feature = "std")]
mod tracker;

pub use beams::Beams;
#[cfg(feature = "std")]
pub use ego::{EgoFilter, YAW_LAG_S};
#[cfg(feature = "std")]
pub use tracker::{Moving, Sighting, Tracker};
