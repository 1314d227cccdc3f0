//! From steps and answers to advice.

mod advisor;
mod dwell;
mod query_policy;

pub use advisor::Advisor;
pub use dwell::Dwell;
pub use query_policy::QueryPolicy;
