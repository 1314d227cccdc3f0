//! The configuration: one TOML file, read by every process of a run.
//!
//! Each section is a struct whose defaults are the paper's numbers. A file names only
//! what it changes; an unknown key is an error that suggests the most similar valid
//! one.

mod deadlines;
mod fit;
mod gate;
mod learner;
mod link;
mod load;
mod mpc;
mod policy;
mod preset;
mod programs;
mod rates;
mod record;
mod run;
mod services;
#[cfg(feature = "wire")]
mod vehicle_file;
mod vlm;
mod world;
mod wrong_type;

use serde::{Deserialize, Serialize};
use vehicle::{InvalidVehicle, Scanner, Vehicle};

use crate::message::{FEATURE_BEAMS, fits_policy};
use crate::settings::in_range;

pub use crate::settings::{
    Controller, GateMode, Informed, Kinodynamic, Late, OutOfRange, Planner, SafetyLimits, planner,
};
pub use deadlines::Deadlines;
pub use gate::{FaultyJudge, Gate, IN_FLIGHT_MAX, PassTo, When};
pub use learner::{Algorithm, Learner};
pub use link::{Link, is_address};
pub use load::{ConfigError, from_toml};
#[cfg(feature = "wire")]
pub use load::{load, text_of};
pub use mpc::Mpc;
pub use policy::{Backend, Policy};
pub use programs::Programs;
pub use rates::DECISION_HZ;
pub use record::{Keep, Record};
pub use run::{Clock, Limits, Run, Supervisor};
#[cfg(feature = "wire")]
pub use vehicle_file::{vehicle_of, with_vehicle};
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
    /// The car, which every part obeys; the real MetaDrive has its own and refuses
    /// others. `--vehicle FILE` reads this section and the next from a vehicle file.
    pub vehicle: Vehicle,
    /// The car's laser scanner.
    pub scanner: Scanner,
    /// The world.
    pub world: World,
    /// Programs of yours in place of those of the build.
    pub programs: Programs,
    /// Processes on other machines.
    pub link: Link,
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
    pub safety: SafetyLimits,
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
    /// The recorder process.
    pub record: Record,
    /// Restarts and real-time privileges.
    pub supervisor: Supervisor,
}

impl Config {
    /// Checks every value against its range and against each other.
    ///
    /// # Errors
    /// The first key that is out of range.
    pub fn validated(mut self) -> Result<Self, OutOfRange> {
        self.run.check()?;
        self.check_rates()?;
        self.limits.check(&self)?;
        self.deadlines.check()?;
        self = self.checked_vehicle()?;
        self.world.check(&self.vehicle, &self.scanner)?;
        self.programs.check(&self.gate)?;
        self.link.check(&self)?;
        self.planner.check()?;
        self.informed.check(self.planner.cell_m)?;
        self.kinodynamic.check()?;
        self.mpc.check()?;
        self.controller.check()?;
        self.safety.check()?;
        self.gate.check(&self.run)?;
        self.vlm.check()?;
        self.faulty_judge.check()?;
        self.policy.check()?;
        self.learner.check()?;
        self.check_policy_fits()?;
        self.record.check()?;
        self.supervisor.check()?;
        Ok(self)
    }

    /// Refuses a policy, and a learner, with a scanner that no policy is trained with.
    fn check_policy_fits(&self) -> Result<(), OutOfRange> {
        let is_distilled = self.gate.mode == GateMode::Distilled;
        let (key, value) = match (self.policy.file.as_str(), self.learner.enabled) {
            ("", false) if is_distilled => ("gate.mode", "distilled".into()),
            ("", false) => return Ok(()),
            ("", true) => ("learner.enabled", "true".into()),
            (file, _) => ("policy.file", format!("{file:?}")),
        };
        if fits_policy(&self.scanner.fan()) {
            return Ok(());
        }
        Err(OutOfRange {
            key: key.into(),
            value,
            expected: format!(
                "left out with this [scanner]: the features of a policy are those of \
                 {FEATURE_BEAMS} beams over 360 degrees from the car's centre; experts drive \
                 with any scanner"
            ),
        })
    }

    /// Checks the car and its scanner, on which the defaults of other keys depend.
    fn checked_vehicle(self) -> Result<Self, OutOfRange> {
        let named = |section: &str, error: InvalidVehicle| OutOfRange {
            key: format!("{section}.{}", error.name),
            value: error.value.to_string(),
            expected: format!("within {} and {}", error.range[0], error.range[1]),
        };
        self.vehicle
            .validated()
            .map_err(|error| named("vehicle", error))?;
        self.scanner
            .validated()
            .map_err(|error| named("scanner", error))?;
        Ok(self)
    }

    /// In lockstep: how long the controller waits for the planner, and for a gate with
    /// a slow judge, ns on the machine's clock.
    pub fn peer_wait_ns(&self) -> u64 {
        let model_s = match self.gate.asks_model() {
            true => self.vlm.deadline_s,
            false => 0.0,
        };
        let picture_s = match self.gate.asks_world() {
            true => Self::PICTURE_S,
            false => 0.0,
        };
        ((self.limits.lockstep_wait_s + model_s + picture_s) * 1e9) as u64
    }

    /// Time that a question takes beside its deadline, s: the frame and two pictures.
    const PICTURE_S: f64 = 3.0;

    /// In lockstep: how long the world waits for a command before the car brakes, ns on
    /// the machine's clock. Includes the time for which the controller may wait for the
    /// learner.
    pub fn world_wait_ns(&self) -> u64 {
        let learner_s = match self.learner.enabled {
            true => self.limits.learner_wait_s,
            false => 0.0,
        };
        self.peer_wait_ns() + (learner_s * 1e9) as u64
    }
}
