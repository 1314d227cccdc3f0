//! The ports of the planner process.

use shm_config::message::{Observation, Plan};
use shm_config::services::{OBSERVATION, PLAN};

shm_config::ports! {
    /// What the planner reads and publishes.
    pub struct Ports of Planner {
        /// What the car perceives.
        observations: read OBSERVATION: Observation,
        /// Its answers.
        plans: write PLAN: Plan,
    }
}
