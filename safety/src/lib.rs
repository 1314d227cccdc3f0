//! The exact geometry in the tick: a proposal to a verdict.
//!
//! [`assess`] is a pure function. It rolls a proposal out with the bicycle model,
//! measures it against the lidar returns and the road's edges, and vetoes it when the
//! brake could no longer prevent what it leads to. Nothing here allocates, waits or
//! reads a clock.

#![no_std]

mod assess;
mod road;

pub use assess::{CLEARANCE_MAX_M, Scene, assess};
pub use road::RoadAhead;
