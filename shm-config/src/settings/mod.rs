//! The settings of the tick: what planner, controller and safety compute with, without
//! the standard library. `config` puts them and all others into one file.

mod choice;
mod controller;
mod informed;
mod kinodynamic;
mod out_of_range;
pub mod planner;

pub use choice::{GateMode, Late};
pub use controller::{Controller, SafetyLimits};
pub use informed::Informed;
pub use kinodynamic::Kinodynamic;
pub use out_of_range::OutOfRange;
pub(crate) use out_of_range::in_range;
pub use planner::Planner;
