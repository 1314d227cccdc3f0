//! From steps and answers to advice.

mod advisor;
mod dwell;
mod policy;

pub use advisor::{Counsel, Heard};
pub use dwell::Dwell;
pub use policy::Occasions;
