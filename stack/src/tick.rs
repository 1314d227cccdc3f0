//! One tick of the stack.

use controller::{Controller, Inputs, Intent, PolicySlot};
use planner::Planner;
use shm_config::config::{Config, OutOfRange};
use shm_config::message::{Header, Observation, Plan, Step};
use tracker::Moving;

/// Planner and controller in lockstep order, without their processes and without a
/// policy. The headers of the observations are those of a run: tick, time, episode.
pub struct Stack {
    config: Config,
    planner: Planner,
    controller: Controller,
    inputs: Inputs,
    plan: Plan,
}

impl Stack {
    /// The stack of this configuration.
    ///
    /// # Errors
    /// When the planner's configuration is out of range.
    pub fn new(config: &Config) -> Result<Stack, OutOfRange> {
        Ok(Stack {
            planner: Planner::new(config)?,
            controller: Controller::new(config.clone(), PolicySlot::new(None)),
            config: config.clone(),
            inputs: Inputs::default(),
            plan: Plan::default(),
        })
    }

    /// Starts anew: no state of earlier ticks is left.
    pub fn forget(&mut self) {
        self.controller = Controller::new(self.config.clone(), PolicySlot::new(None));
        self.planner.forget();
    }

    /// The planner's tick, without the plans before.
    pub(crate) fn plan_anew(&mut self, observation: &Observation, moving: &[Moving]) {
        self.planner.plan_anew(observation, moving, &mut self.plan);
    }

    /// The planner's tick.
    pub fn plan(&mut self, observation: &Observation) -> &Plan {
        self.planner.plan(observation, &mut self.plan);
        &self.plan
    }

    /// The controller's tick with the last plan.
    pub fn control(&mut self, observation: &Observation) -> &Step {
        self.inputs.observation.keep(observation);
        self.inputs.plan.keep(&self.plan);
        let Header { tick, .. } = observation.header;
        let now = observation.header.taken();
        self.controller.tick(&self.inputs, tick, now, Intent::Drive)
    }

    /// The last plan; empty before the first tick.
    pub fn last_plan(&self) -> &Plan {
        &self.plan
    }

    pub(crate) fn last_plan_mut(&mut self) -> &mut Plan {
        &mut self.plan
    }
}
