//! Observation to plan, by one of several methods ([`Planner`]).
//!
//! The paper's is [`RrtStar`]: occupancy grid, local goal, RRT* (Sec. 4.1.1).
//!
//! ```text
//! Observation -> Grid::fill -> choose_goal -> RRT* -> Plan
//! ```
//!
//! Everything is in the body frame of the observation: x forward, y left,
//! metres. [`Planner::plan`] is a function of the configuration and the
//! observation alone: the same input gives the same plan, bit for bit, also
//! after a restart. It takes no memory and no lock and reads no clock.

mod beams;
mod centre_line;
mod corridor;
mod dubins;
mod ellipse;
mod goal;
mod grid;
mod informed;
mod kinodynamic;
mod mpc;
mod planner;
mod rrt_star;
mod sampler;
mod search;
mod segment;
mod track;
mod tree;

pub use corridor::Corridor;
pub use dubins::{Dubins, Piece, Turn};
pub use goal::choose_goal;
pub use grid::{Cell, Grid};
pub use informed::Informed;
pub use kinodynamic::{Kinodynamic, PoseNode};
pub use mpc::{Effort, Mpc};
pub use planner::Planner;
pub use rrt_star::RrtStar;
pub use shm_config::config::Planner as PlannerConfig;
pub use tree::{Node, Tree};
