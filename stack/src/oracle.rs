//! The expert's action at any observation.

use shm_config::config::{Clock, Config, GateMode, OutOfRange};
use shm_config::message::{Header, Observation};
use vehicle::Action;

use crate::Stack;

/// Time between two questions on the oracle's own clock, ns: longer than any age
/// limit, so that no answer depends on the one before.
const APART_NS: u64 = 1_000_000_000_000;

/// Planner and controller of the run, with the safety check of the tick and without a
/// policy.
pub struct Oracle {
    stack: Box<Stack>,
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
        // An answer must not depend on the machine's speed.
        config.run.clock = Clock::Lockstep;
        Ok(Oracle {
            stack: Box::new(Stack::new(&config)?),
            asked: 0,
        })
    }

    /// The expert's command here, without a state before it. The planner's random
    /// numbers are those of the observation's tick and episode, so that the answer
    /// depends on the observation alone.
    pub fn ask(&mut self, observation: &mut Observation) -> Action {
        self.stack.plan_anew(observation);
        self.asked = self.asked.wrapping_add(1);
        let tick = u64::from(self.asked);
        let header = Header {
            tick,
            taken_ns: tick * APART_NS,
            episode: self.asked,
            ..Header::default()
        };
        (observation.header, self.stack.last_plan_mut().header) = (header, header);
        self.stack.control(observation).command.action()
    }
}
