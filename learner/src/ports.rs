//! The ports of the learner process.

use shm_config::message::{Learning, PolicyStatus, Step, Weights};
use shm_config::services::{LEARNING, POLICY_STATUS, STEP, WEIGHTS};

shm_config::ports! {
    /// What the learner reads and publishes at every step.
    pub struct Ports of Learner with bell {
        /// The record of each tick.
        steps: read STEP: Step,
        /// The status of its offers.
        statuses: read POLICY_STATUS: PolicyStatus,
        /// Its progress.
        learning: write LEARNING: Learning,
    }
}

shm_config::ports! {
    /// Its offers. The port is connected when the learner makes one: a restarted
    /// controller begins with the weights it kept, not with the last offer.
    pub struct OfferPorts of Learner {
        /// Policies.
        weights: write WEIGHTS: Weights,
    }
}
