use shm_config::Instant;
use shm_config::config::Config;
use shm_config::message::{Admission, Before, Intent, MOTION_AT_REST, Observation, Step};
use tracker::Tracker;

use crate::policy::Limits;
use crate::{Arbiter, ArbiterConfig, Inputs, PolicySlot};

/// The controller without its ports: inputs in, step out.
pub struct Controller {
    pub(crate) arbiter: Arbiter,
    pub(crate) policy: PolicySlot,
    pub(crate) limits: Limits,
    pub(crate) observation_age_ns: u64,
    /// Follows what moves, as long as a policy takes it or a learner trains one that will.
    tracker: Box<Tracker>,
    trains_motion: bool,
}

impl Controller {
    /// A controller with this policy, or none.
    pub fn new(config: Config, policy: PolicySlot) -> Self {
        Self {
            arbiter: Arbiter::new(ArbiterConfig::from(&config)),
            policy,
            limits: Limits::from(&config.policy),
            observation_age_ns: config.limits.observation_age_ns(),
            tracker: Box::default(),
            trains_motion: config.learner.trains_motion(),
        }
    }

    /// Goes on from the state before a tick; `step` is the one before it, with the messages
    /// that were admitted.
    pub fn resume(&mut self, before: &Before, step: Step) {
        self.arbiter.restore(before, step);
    }

    /// Follows what moves in an observation, if a policy takes it. [`Controller::admit`] does
    /// so, too; what was followed before costs nothing then. The process calls this while the
    /// plan is made, and a drive that begins in the middle of a run for what came before.
    pub fn follow(&mut self, observation: &Observation) {
        if self.tells_motion() {
            self.tracker.follow(observation);
        }
    }

    fn tells_motion(&self) -> bool {
        self.trains_motion || self.policy.takes_motion()
    }

    /// One tick, start to end. Always answers.
    pub fn tick(&mut self, inputs: &Inputs, tick: u64, now: Instant, intent: Intent) -> &Step {
        self.admit(inputs, now);
        self.decide(tick, now, intent)
    }

    /// The first half of a tick, the door. Returns whether an observation came and
    /// was admitted.
    pub fn admit(&mut self, inputs: &Inputs, now: Instant) -> bool {
        self.arbiter.admit(inputs, now);
        let tells_motion = self.tells_motion();
        let step = self.arbiter.step_mut();
        let came = step.observation_entry.admission() == Admission::Admitted;
        if came && tells_motion {
            self.tracker.follow(&step.observation);
            step.motion = self.tracker.motion();
        } else if came {
            step.motion.fill(MOTION_AT_REST);
        }
        came
    }

    /// The second half of a tick, on what [`Controller::admit`] let in.
    pub fn decide(&mut self, tick: u64, now: Instant, intent: Intent) -> &Step {
        let sees = self.arbiter.sees(now);
        let answer = self.policy.answer(self.arbiter.step(), sees);
        self.arbiter.decide(tick, now, intent, &answer);
        self.arbiter.step()
    }

    /// As [`Arbiter::complete`].
    pub fn complete(&mut self, scheduled: Instant, decided: Instant) -> bool {
        self.arbiter.complete(scheduled, decided)
    }

    /// As [`Arbiter::answer_late`].
    pub fn answer_late(&mut self) -> bool {
        self.arbiter.answer_late()
    }

    /// The record of the last tick.
    pub fn step(&self) -> &Step {
        self.arbiter.step()
    }

    /// The record of the last tick, for the process to add its timings to.
    pub fn step_mut(&mut self) -> &mut Step {
        self.arbiter.step_mut()
    }
}
