//! The expert's action at any observation.

use shm_config::config::{Clock, Config, GateMode, OutOfRange};
use shm_config::message::{BEAMS_MAX, Header, MOTION_FEATURES, Observation};
use tracker::{Moving, Tracker};
use vehicle::Action;

use crate::Stack;

/// Time between two questions on the oracle's own clock, ns: longer than any age
/// limit, so that no answer depends on the one before.
const APART_NS: u64 = 1_000_000_000_000;

/// Planner and controller of the run, with the safety check of the tick and without a
/// policy.
pub struct Oracle {
    stack: Box<Stack>,
    tracker: Box<Tracker>,
    /// What moves in the observation that was watched last.
    moving: Vec<Moving>,
    /// For the observations that are asked about.
    there: Box<Tracker>,
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
            tracker: Box::default(),
            moving: Vec::with_capacity(BEAMS_MAX),
            there: Box::default(),
            asked: 0,
        })
    }

    /// Follows what moves from one observation of a drive to the next: the answers that
    /// follow know how the bodies seen there move.
    pub fn watch(&mut self, observation: &Observation) {
        self.tracker.follow(observation);
        self.moving.clear();
        self.moving.extend(self.tracker.moving(observation));
    }

    /// How the bodies move in an observation near the one that was watched last, as a policy
    /// takes it; all rest if none was.
    pub fn motion(&mut self, observation: &Observation) -> [f32; MOTION_FEATURES] {
        self.there.suppose(observation, &self.moving);
        self.there.motion()
    }

    /// The expert's command here, without a plan before it, at the time of the observation
    /// that was watched last; all rests if none was. The planner's random numbers are those
    /// of the observation's tick and episode, so that the answer depends on nothing else.
    pub fn ask(&mut self, observation: &mut Observation) -> Action {
        self.stack.plan_anew(observation, &self.moving);
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
