//! Observation to plan, by one of four methods ([`Planner`]).
//!
//! ```text
//! RrtStar      Observation -> Grid -> choose_goal -> RRT* -> Plan       (Sec. 4.1.1)
//! Informed     the same, from the last path on, sampling in an ellipse
//! Kinodynamic  Observation -> Grid along the road -> RRT* over Dubins curves -> Plan
//! Mpc          Observation -> tracks -> lattice, speed -> quadratic programme -> Plan
//! ```
//!
//! Everything is in the body frame of the observation: x forward, y left,
//! metres. [`RrtStar`] and [`Kinodynamic`] are functions of the configuration
//! and the observation alone: the same input gives the same plan, bit for bit,
//! also after a restart. [`Informed`] and [`Mpc`] remember within an episode.
//! The three RRT* allocate nothing, take no lock and read no clock; the solver of
//! [`Mpc`] allocates once for each plan and looks at the clock for its limit.
//!
//! Without the feature `std` (and with `libm`), the three RRT* need neither the standard
//! library nor an allocator: they plan in memory of the caller's
//! ([`RrtStar::within`]).
//!
//! ```
//! use planner::{PlannerConfig, RrtStar};
//! use shm_config::message::{Observation, Plan, PlanOutcome};
//!
//! let mut observation = Observation::default();
//! // No beam hits anything. A scan without beams would leave nothing free.
//! observation.beam_count = 240;
//! observation.ranges_m.fill(observation.lidar_max_m);
//! (observation.road.left_m, observation.road.right_m) = (5.0, 5.0);
//! observation.checkpoints[0].x_body_m = 30.0;
//!
//! let mut planner = RrtStar::new(PlannerConfig::default())?;
//! let mut plan = Plan::default();
//! planner.plan(&observation, &mut plan);
//! assert_ne!(plan.outcome(), PlanOutcome::Blocked);
//! assert!(plan.waypoints().len() > 1);
//! # Ok::<(), shm_config::settings::OutOfRange>(())
//! ```

#![cfg_attr(not(feature = "std"), no_std)]

mod buckets;
mod centre_line;
mod corridor;
mod dubins;
mod ellipse;
mod goal;
mod grid;
mod informed;
mod kinodynamic;
mod memory;
#[cfg(feature = "std")]
mod mpc;
#[cfg(feature = "std")]
mod planner;
#[cfg(feature = "process")]
pub mod ports;
#[cfg(feature = "process")]
mod process;
mod rrt_star;
mod sampler;
mod search;
mod segment;
mod tree;

pub use centre_line::{CentreLine, Station};
pub use corridor::Corridor;
pub use dubins::{Dubins, Piece, Turn};
pub use goal::choose_goal;
pub use grid::{Cell, Grid};
pub use informed::Informed;
pub use kinodynamic::{Kinodynamic, Path, PoseNode, Search as PoseSearch};
pub use memory::{GridWords, Place};
#[cfg(feature = "std")]
pub use mpc::{Effort, Mpc};
#[cfg(feature = "std")]
pub use planner::Planner;
#[cfg(feature = "process")]
pub use process::{PlannerProcess, run};
pub use rrt_star::RrtStar;
pub use search::Search;
pub use shm_config::settings::Planner as PlannerConfig;
pub use tree::{Node, Tree};
