//! The ports of the controller process.

use shm_config::message::{
    Advice, Command, Kept, Learning, Observation, Plan, PolicyStatus, Step, Takeover, Weights,
};
use shm_config::services::{
    ADVICE, COMMAND, KEPT, LEARNING, OBSERVATION, PLAN, POLICY_STATUS, STEP, TAKEOVER, WEIGHTS,
};

shm_config::ports! {
    /// What a tick reads and publishes.
    pub struct Ports of Controller {
        /// What the car perceives.
        observations: read OBSERVATION: Observation,
        /// Answers of the planner.
        plans: read PLAN: Plan,
        /// Answers of the gate.
        advices: read ADVICE: Advice,
        /// The driver's takeover messages.
        takeovers: read TAKEOVER: Takeover,
        /// What the car shall do.
        commands: write COMMAND: Command,
        /// The record of each tick.
        steps: write STEP: Step,
    }
}

shm_config::ports! {
    /// What the loader's thread reads and publishes.
    pub struct LoaderPorts of Controller {
        /// Policies that are offered.
        weights: read WEIGHTS: Weights,
        /// What became of them.
        status: write POLICY_STATUS: PolicyStatus,
    }
}

shm_config::ports! {
    /// How far the learner is, which a run in lockstep waits for.
    pub struct LearnerPorts of Controller {
        /// How far it is.
        learning: read LEARNING: Learning,
    }
}

shm_config::ports! {
    /// How far the recorder is, which a run in lockstep waits for.
    pub struct RecorderPorts of Controller {
        /// How far it is.
        kept: read KEPT: Kept,
    }
}
