//! The exact geometry in the tick: a proposal to a verdict.
//!
//! [`assess`] is a pure function. It rolls a proposal out with the bicycle model,
//! measures it against the lidar returns and the road's edges, and vetoes it when the
//! brake could no longer prevent what it leads to. Nothing here allocates, waits or
//! reads a clock. The crate needs neither the standard library nor an allocator; the
//! feature `libm` gives the mathematics where `std` does not.
//!
//! ```
//! use safety::{Scene, assess};
//! use shm_config::message::Observation;
//! use shm_config::settings::SafetyLimits;
//! use vehicle::{Action, Vehicle};
//!
//! let (car, limits) = (Vehicle::default(), SafetyLimits::default());
//! let mut observation = Observation::default();
//! (observation.road.left_m, observation.road.right_m) = (5.0, 5.0);
//! observation.ego.speed_mps = 8.0;
//! (observation.beam_count, observation.lidar_max_m) = (4, 50.0);
//! observation.ranges_m[..4].copy_from_slice(&[4.0, 50.0, 50.0, 50.0]);
//!
//! let scene = Scene::new(&observation, Scene::reach_m(&car, &limits, 8.0));
//! let ahead = Action { steer: 0.0, pedal: 1.0 };
//! assert!(assess(&car, &limits, &scene, Some(ahead)).is_vetoed());
//! ```

#![no_std]

mod assess;
mod road;

pub use assess::{CLEARANCE_MAX_M, Scene, assess};
pub use road::RoadAhead;
