//! The configuration: one TOML file, read by every process of a run.
//!
//! Each section is a struct whose defaults are the paper's numbers. A file names only
//! what it changes; an unknown key is an error that suggests the most similar valid
//! one.

mod deadlines;
mod gate;
mod learner;
mod load;
mod mpc;
mod policy;
mod preset;
mod rates;
mod run;
mod services;
mod vlm;
mod world;
mod wrong_type;

use serde::{Deserialize, Serialize};
use vehicle::Vehicle;

use crate::settings::in_range;

pub use crate::settings::{
    Controller, GateMode, Informed, JudgeLimits, Kinodynamic, Late, OutOfRange, Planner, planner,
};
pub use deadlines::Deadlines;
pub use gate::{FaultyJudge, Gate, When};
pub use learner::{Algorithm, Learner};
pub use load::{ConfigError, from_toml};
#[cfg(feature = "wire")]
pub use load::{load, text_of};
pub use mpc::Mpc;
pub use policy::{Backend, Policy};
pub use rates::DECISION_HZ;
pub use run::{Clock, Limits, Run, Supervisor};
pub use vlm::{PictureFormat, PromptPreset, Rollout, STAND_IN, View, Vlm};
pub use world::{Simulator, World};

/// The whole configuration of a run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Name, clock, seeds and length of the run.
    pub run: Run,
    /// Age limits and waiting times.
    pub limits: Limits,
    /// What follows when ticks are late or slow.
    pub deadlines: Deadlines,
    /// The car with which planner and safety check compute. The worlds have their own
    /// car and do not use these values yet, so other values are refused.
    pub vehicle: Vehicle,
    /// The world.
    pub world: World,
    /// RRT*.
    pub planner: Planner,
    /// RRT* with a memory, in place of the paper's.
    pub informed: Informed,
    /// RRT* over the bicycle, in place of the paper's.
    pub kinodynamic: Kinodynamic,
    /// Model-predictive control.
    pub mpc: Mpc,
    /// PD tracking.
    pub controller: Controller,
    /// The safety check in the tick.
    pub judge: JudgeLimits,
    /// The gate process.
    pub gate: Gate,
    /// The vision-language model that the gate process asks.
    pub vlm: Vlm,
    /// Faults injected into the judge, for experiments.
    pub faulty_judge: FaultyJudge,
    /// The policy: its weights, the runtime of its net, and when weights are rolled
    /// back.
    pub policy: Policy,
    /// The learner process.
    pub learner: Learner,
    /// Restarts and real-time privileges.
    pub supervisor: Supervisor,
}

impl Config {
    /// Checks every value against its range and against each other.
    ///
    /// # Errors
    /// The first key that is out of range.
    pub fn validated(self) -> Result<Self, OutOfRange> {
        self.run.check()?;
        self.check_rates()?;
        self.limits.check(&self)?;
        self.deadlines.check()?;
        self.vehicle.validated().map_err(|error| OutOfRange {
            key: format!("vehicle.{}", error.name),
            value: error.value.to_string(),
            expected: format!("positive and at most {}", error.limit),
        })?;
        self.world.check(&self.vehicle)?;
        self.planner.check()?;
        self.informed.check(self.planner.cell_m)?;
        self.kinodynamic.check()?;
        self.mpc.check()?;
        self.controller.check()?;
        self.judge.check()?;
        self.gate.check(&self.run)?;
        self.vlm.check()?;
        self.faulty_judge.check()?;
        self.policy.check()?;
        self.learner.check()?;
        self.supervisor.check()?;
        Ok(self)
    }

    /// In lockstep: how long the controller waits for the planner, and for a gate with
    /// a slow judge, ns on the machine's clock.
    pub fn peer_wait_ns(&self) -> u64 {
        let model_s = match self.gate.asks_model() {
            true => self.vlm.deadline_s + Self::PICTURE_S,
            false => 0.0,
        };
        ((self.limits.lockstep_wait_s + model_s) * 1e9) as u64
    }

    /// Time that a question takes beside its deadline, s: the frame and two pictures.
    const PICTURE_S: f64 = 3.0;

    /// In lockstep: how long the world waits for a command before the car brakes, ns on
    /// the machine's clock. Includes the time for which the controller may wait for the
    /// learner.
    pub fn world_wait_ns(&self) -> u64 {
        let learner_s = match self.learner.enabled {
            true => Learner::LOCKSTEP_WAIT_S,
            false => 0.0,
        };
        self.peer_wait_ns() + (learner_s * 1e9) as u64
    }
}
