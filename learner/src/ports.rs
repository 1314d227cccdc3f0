//! The ports of the learner process.

use shm_config::message::{Learning, PolicyStatus, Step, Weights};
use shm_config::services::{LEARNING, POLICY_STATUS, STEP, WEIGHTS};

shm_config::ports! {
    /// What the learner reads and publishes at every step.
    pub struct Ports of Learner with bell {
        /// The record of each tick.
        steps: read STEP: Step,
        /// What became of its offers.
        statuses: read POLICY_STATUS: PolicyStatus,
        /// How far it is.
        learning: write LEARNING: Learning,
    }
}

shm_config::ports! {
    /// Its offers, connected when it makes one: a controller that was restarted begins
    /// with the weights it kept, not with the last offer.
    pub struct OfferPorts of Learner {
        /// Policies.
        weights: write WEIGHTS: Weights,
    }
}
