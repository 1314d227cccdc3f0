//! The expert as a program: asked what it would command at any observation.

use controller::{Controller, Inputs, Intent, PolicySlot};
use planner::Planner;
use shm_config::config::{Clock, Config, GateMode, OutOfRange};
use shm_config::message::{Header, Observation, Plan};
use vehicle::Action;

/// From question to question on the oracle's own clock, ns: longer than any age
/// limit, so that no answer knows the one before.
const APART_NS: u64 = 1_000_000_000_000;

/// Planner and controller of the run, with the judge in the tick and without a
/// policy.
pub struct Oracle {
    planner: Planner,
    controller: Controller,
    plan: Box<Plan>,
    asked: u32,
}

impl Oracle {
    /// The expert of this configuration.
    ///
    /// # Errors
    /// When the planner's configuration is out of range.
    pub fn new(config: &Config) -> Result<Oracle, OutOfRange> {
        let mut config = config.clone();
        config.gate.mode = GateMode::Expert;
        // Nothing may depend on how fast this machine is now.
        config.run.clock = Clock::Lockstep;
        Ok(Oracle {
            planner: Planner::new(&config)?,
            controller: Controller::new(config, PolicySlot::new(None)),
            plan: Box::default(),
            asked: 0,
        })
    }

    /// What the expert would command here, knowing nothing of what was before.
    /// The planner's random numbers are those of the observation's tick and
    /// episode, so that the answer depends on the observation alone.
    pub fn ask(&mut self, observation: &mut Observation) -> Action {
        self.planner.forget();
        self.planner.plan(observation, &mut self.plan);
        self.asked = self.asked.wrapping_add(1);
        let tick = u64::from(self.asked);
        let header = Header {
            tick,
            taken_ns: tick * APART_NS,
            episode: self.asked,
            ..Header::default()
        };
        (observation.header, self.plan.header) = (header, header);
        let inputs = Inputs {
            observation: Some(*observation),
            plan: Some(*self.plan),
            ..Inputs::default()
        };
        let now = observation.header.taken();
        let step = self.controller.tick(&inputs, tick, now, Intent::Drive);
        Action {
            steer: step.command.steer,
            pedal: step.command.pedal,
        }
    }
}
