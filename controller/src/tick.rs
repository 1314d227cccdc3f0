use gate::{Scene, assess};
use shm_config::config::{Config, GateMode, Late};
use shm_config::message::{
    Advice, Assessment, Command, Driver, Observation, Plan, Proposal, Reason, Step, Takeover,
};
use shm_config::{Instant, Message};
use vehicle::Action;

use crate::{Choice, Intent, Pd, PolicySlot, Standing, Transfer, choose};

/// What came since the last tick. The ports have refused what was inadmissible when it
/// was read; the tick decides at a later instant, and looks at each once more.
#[derive(Debug, Clone, Copy, Default)]
pub struct Inputs {
    /// The newest observation.
    pub observation: Option<Observation>,
    /// The newest plan.
    pub plan: Option<Plan>,
    /// The newest advice.
    pub advice: Option<Advice>,
    /// The newest word of a person.
    pub takeover: Option<Takeover>,
    /// Messages that the ports have refused since the last tick.
    pub refused: u64,
}

/// The controller without its ports: inputs in, step out.
pub struct Controller {
    pub(crate) config: Config,
    pd: Pd,
    pub(crate) policy: PolicySlot,
    transfer: Transfer,
    has_observation: bool,
    has_plan: bool,
    has_advice: bool,
    /// The record of the last tick; also holds the last admitted inputs.
    pub(crate) step: Step,
}

impl Controller {
    /// A controller with this policy, or none.
    pub fn new(config: Config, policy: PolicySlot) -> Self {
        Self {
            pd: Pd::new(config.controller),
            transfer: Transfer::of(&config),
            config,
            policy,
            has_observation: false,
            has_plan: false,
            has_advice: false,
            step: Step::default(),
        }
    }

    /// One tick, start to end. Always answers.
    pub fn tick(&mut self, inputs: &Inputs, tick: u64, now: Instant, intent: Intent) -> &Step {
        self.admit(inputs, now);
        self.decide(tick, now, intent)
    }

    /// The second half of a tick, on what [`Controller::admit`] let in.
    pub fn decide(&mut self, tick: u64, now: Instant, intent: Intent) -> &Step {
        let limits = &self.config.limits;
        let observation = &self.step.observation;
        let observation_age_ns = age_ns(self.has_observation, observation, now);
        let plan_age_ns = age_ns(self.has_plan, &self.step.plan, now);
        let sees = observation_age_ns <= limits.observation_age_ns();
        let has_plan = sees
            && plan_age_ns <= self.config.plan_age_ns()
            && self.step.plan.header.episode == observation.header.episode;

        let plan = has_plan.then_some(&self.step.plan);
        let planned = plan.and_then(|plan| match plan.actions() {
            [] => self.pd.propose(plan, observation),
            _ => plan.action_at(plan_age_ns),
        });
        // A person who has taken over is the expert of the tick.
        let takeover = self.takeover(now);
        let expert = takeover.or(planned);
        let policy = sees.then(|| self.policy.propose(observation)).flatten();
        let [expert_assessment, policy_assessment] = self.judge(sees, [expert, policy]);

        let mut choice = choose(&Standing {
            intent,
            mode: self.config.gate.mode,
            now,
            sees,
            plan,
            advice: self.has_advice.then_some(&self.step.advice),
            stage: self.policy.stage(),
            takeover,
            expert,
            policy,
            expert_assessment: &expert_assessment,
            policy_assessment: &policy_assessment,
        });

        let mut transfer = self.transfer;
        let episode = self.step.observation.header.episode;
        choice.action = transfer.ease(&choice, episode, |eased| {
            let [assessment] = self.judge(sees, [Some(eased)]);
            !assessment.is_vetoed()
        });
        self.transfer = transfer;

        self.record(tick, now, choice);
        let step = &mut self.step;
        step.expert = Proposal::new(expert);
        step.policy = Proposal::new(policy);
        step.expert_assessment = expert_assessment;
        step.policy_assessment = policy_assessment;
        step.observation_age_ns = observation_age_ns;
        step.plan_age_ns = plan_age_ns;
        step
    }

    /// The first half of a tick, the door: what is refused is counted, and the last
    /// good one stays. Returns whether an observation came and was let in.
    pub fn admit(&mut self, inputs: &Inputs, now: Instant) -> bool {
        let limits = &self.config.limits;
        self.step.refused += inputs.refused;
        let mut sees = false;
        if let Some(observation) = &inputs.observation {
            match observation.admit(now, limits.observation_age_ns()) {
                Ok(()) => {
                    self.step.observation = *observation;
                    self.has_observation = true;
                    sees = true;
                }
                Err(_) => self.step.refused += 1,
            }
        }
        if let Some(plan) = &inputs.plan {
            match plan.admit(now, self.config.plan_age_ns()) {
                Ok(()) => {
                    self.step.plan = *plan;
                    self.has_plan = true;
                }
                Err(_) => self.step.refused += 1,
            }
        }
        if let Some(advice) = &inputs.advice {
            // Advice has its own expiry; its age says nothing.
            match advice.admit(now, u64::MAX) {
                Ok(()) => {
                    self.step.advice = *advice;
                    self.has_advice = true;
                }
                Err(_) => self.step.refused += 1,
            }
        }
        if let Some(takeover) = &inputs.takeover {
            match takeover.admit(now, limits.takeover_age_ns()) {
                Ok(()) => self.step.takeover = *takeover,
                Err(_) => self.step.refused += 1,
            }
        }
        sees
    }

    /// What a person wants who has taken over; `None` when nobody has, or the
    /// last word is too old.
    fn takeover(&self, now: Instant) -> Option<Action> {
        let takeover = &self.step.takeover;
        let age_ns = now.since_ns(takeover.header.taken());
        let holds = self.config.gate.mode == GateMode::Human
            && age_ns <= self.config.limits.takeover_age_ns();
        takeover.action().filter(|_| holds)
    }

    /// The judge in the tick, on these proposals.
    pub(crate) fn judge<const N: usize>(
        &self,
        sees: bool,
        proposals: [Option<Action>; N],
    ) -> [Assessment; N] {
        if !sees {
            return proposals.map(|_| Assessment::default());
        }
        let (vehicle, limits) = (&self.config.vehicle, &self.config.judge);
        let observation = &self.step.observation;
        let reach_m = Scene::reach_m(vehicle, limits, observation.ego.speed_mps);
        let scene = Scene::new(observation, reach_m);
        proposals.map(|proposal| assess(vehicle, limits, &scene, proposal))
    }

    fn record(&mut self, tick: u64, now: Instant, choice: Choice) {
        let step = &mut self.step;
        step.header.tick = tick;
        step.header.taken_ns = now.0;
        step.header.episode = step.observation.header.episode;
        step.command = Command {
            header: step.header,
            steer: choice.action.steer,
            pedal: choice.action.pedal,
            driver: choice.driver.code(),
            reason: choice.reason.code(),
        };
        step.advice_age_ns = match self.has_advice && step.advice.answers > 0 {
            true => now.since_ns(Instant(step.advice.question_taken_ns)),
            false => u64::MAX,
        };
        (step.weights_version, step.weights_hash) = self.policy.weights();
    }

    /// The tick that was just decided is over its deadline: does with it what
    /// `deadlines.controller` says. Returns whether its command goes out.
    pub fn answer_late(&mut self) -> bool {
        let policy = self.config.deadlines.controller;
        let command = &mut self.step.command;
        if policy != Late::Count {
            command.reason = Reason::Late.code();
        }
        if policy == Late::Brake {
            // Along the line that was decided: straight wheels leave a bend.
            command.pedal = Action::BRAKE.pedal;
            command.driver = Driver::Brake.code();
        }
        policy != Late::Skip
    }

    /// The record of the last tick.
    pub fn step(&self) -> &Step {
        &self.step
    }

    /// The record of the last tick, for the process to add its timings to.
    pub fn step_mut(&mut self) -> &mut Step {
        &mut self.step
    }
}

fn age_ns<M: Message>(is_there: bool, message: &M, now: Instant) -> u64 {
    match is_there {
        true => now.since_ns(message.header().taken()),
        false => u64::MAX,
    }
}
