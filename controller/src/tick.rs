//! The tick's arithmetic: messages, the policy's answer and the time in, a step out.

use safety::{Scene, assess};
#[cfg(feature = "std")]
use shm_config::config::Config;
use shm_config::message::{
    Admission, Advice, Assessment, Before, Command, Driver, Entry, Intent, Lateness, Newest,
    Observation, Plan, Proposal, Reason, ShadowProposal, Stage, Step, Takeover,
};
use shm_config::settings::{self, GateMode, Late, SafetyLimits};
use shm_config::{Instant, Message};
use vehicle::{Action, Vehicle};

use crate::{ArbitrationInput, Choice, Pd, Transfer, choose};

/// What came since the last tick. The ports have refused what was inadmissible when it
/// was read; the tick decides at a later instant, and checks each message again.
#[derive(Debug, Clone, Default)]
pub struct Inputs {
    /// The newest observation.
    pub observation: Newest<Observation>,
    /// The newest plan.
    pub plan: Newest<Plan>,
    /// The newest advice.
    pub advice: Newest<Advice>,
    /// The newest takeover message.
    pub takeover: Newest<Takeover>,
    /// When the ports admitted them.
    pub admitted: AdmittedAt,
    /// Messages that the ports have refused since the last tick.
    pub refused: u64,
}

impl Inputs {
    /// Forgets the messages: nothing has come since the tick.
    pub fn clear(&mut self) {
        self.observation.clear();
        self.plan.clear();
        self.advice.clear();
        self.takeover.clear();
        (self.admitted, self.refused) = Default::default();
    }
}

/// The clock reads at which the ports admitted the inputs of a tick, ns; what did not
/// come keeps any number.
#[derive(Debug, Clone, Copy, Default)]
pub struct AdmittedAt {
    /// Of the observation.
    pub observation_ns: u64,
    /// Of the plan.
    pub plan_ns: u64,
    /// Of the advice.
    pub advice_ns: u64,
    /// Of the takeover message.
    pub takeover_ns: u64,
}

/// What the policies say in one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PolicyAnswer {
    /// How far the policy is.
    pub stage: Stage,
    /// The active policy's proposal, clamped; `None` when there is none.
    pub proposal: Option<Action>,
    /// Version and hash of the active weights; zeros for none.
    pub weights: (u64, u64),
}

/// The part of the configuration that decides ticks.
#[derive(Debug, Clone, Copy)]
pub struct ArbiterConfig {
    /// The tracking's gains, and the rates of a hand-over.
    pub gains: settings::Controller,
    /// Limits of the verdict.
    pub safety: SafetyLimits,
    /// The car.
    pub vehicle: Vehicle,
    /// What decides which driver drives.
    pub mode: GateMode,
    /// For [`GateMode::Takeover`]: the expert drives when the proposals differ by more.
    pub takeover_difference: Action,
    /// What becomes of a late command.
    pub late: Late,
    /// From tick to tick, ns.
    pub period_ns: u64,
    /// In lockstep no command is late.
    pub is_lockstep: bool,
    /// Older observations are not driven on, ns.
    pub observation_age_ns: u64,
    /// Older plans are not followed, ns.
    pub plan_age_ns: u64,
    /// Older takeover messages are ignored, ns.
    pub takeover_age_ns: u64,
}

#[cfg(feature = "std")]
impl From<&Config> for ArbiterConfig {
    fn from(config: &Config) -> Self {
        Self {
            gains: config.controller,
            safety: config.safety,
            vehicle: config.vehicle,
            mode: config.gate.mode,
            takeover_difference: Action {
                steer: config.gate.takeover_steer,
                pedal: config.gate.takeover_pedal,
            },
            late: config.deadlines.controller,
            period_ns: config.run.period_ns(),
            is_lockstep: config.run.is_lockstep(),
            observation_age_ns: config.limits.observation_age_ns(),
            plan_age_ns: config.plan_age_ns(),
            takeover_age_ns: config.limits.takeover_age_ns(),
        }
    }
}

/// Decides each tick: the controller without ports, policies and clock.
pub struct Arbiter {
    config: ArbiterConfig,
    pd: Pd,
    transfer: Transfer,
    has_observation: bool,
    has_plan: bool,
    has_advice: bool,
    /// The record of the last tick; also holds the last admitted inputs.
    step: Step,
}

impl Arbiter {
    /// An arbiter that has admitted nothing yet.
    pub fn new(config: ArbiterConfig) -> Self {
        Self {
            pd: Pd::new(config.gains),
            transfer: Transfer::of(&config),
            config,
            has_observation: false,
            has_plan: false,
            has_advice: false,
            step: Step::default(),
        }
    }

    /// Puts the state back that a tick began with: `step` holds the messages admitted
    /// before it.
    pub fn restore(&mut self, before: &Before, step: Step) {
        self.pd.restore(&before.pd);
        self.transfer.restore(&before.transfer);
        self.has_observation = before.has_observation == 1;
        self.has_plan = before.has_plan == 1;
        self.has_advice = before.has_advice == 1;
        self.step = step;
        self.step.refused = before.refused;
    }

    /// The state with which the next tick begins, beside the messages in the last step.
    pub fn state(&self) -> Before {
        Before {
            pd: self.pd.state(),
            transfer: self.transfer.state(),
            refused: self.step.refused,
            has_observation: u32::from(self.has_observation),
            has_plan: u32::from(self.has_plan),
            has_advice: u32::from(self.has_advice),
            reserved: 0,
        }
    }

    /// The first half of a tick, the door: what is refused is counted, and the last
    /// good one stays.
    pub fn admit(&mut self, inputs: &Inputs, now: Instant) {
        let before = self.state();
        let (config, at) = (&self.config, &inputs.admitted);
        let step = &mut self.step;
        step.before = before;
        step.refused_at_ports = inputs.refused;
        step.refused += inputs.refused;
        let refused = &mut step.refused;
        let mut entry = |port_ns, admission| entry(refused, port_ns, admission);
        let observation = admit(
            &inputs.observation,
            &mut step.observation,
            (now, config.observation_age_ns),
        );
        step.observation_entry = entry(at.observation_ns, observation);
        let plan = admit(&inputs.plan, &mut step.plan, (now, config.plan_age_ns));
        step.plan_entry = entry(at.plan_ns, plan);
        // Advice has its own expiry; its age says nothing.
        let advice = admit(&inputs.advice, &mut step.advice, (now, u64::MAX));
        step.advice_entry = entry(at.advice_ns, advice);
        let takeover = admit(
            &inputs.takeover,
            &mut step.takeover,
            (now, config.takeover_age_ns),
        );
        step.takeover_entry = entry(at.takeover_ns, takeover);
        self.has_observation |= observation == Admission::Admitted;
        self.has_plan |= plan == Admission::Admitted;
        self.has_advice |= advice == Admission::Admitted;
    }

    /// Whether the tick at `now` has an observation young enough to drive on.
    pub fn sees(&self, now: Instant) -> bool {
        self.observation_age_ns(now) <= self.config.observation_age_ns
    }

    /// The second half of a tick, on what [`Arbiter::admit`] let in.
    pub fn decide(&mut self, tick: u64, now: Instant, intent: Intent, answer: &PolicyAnswer) {
        let observation = &self.step.observation;
        let observation_age_ns = self.observation_age_ns(now);
        let plan_age_ns = age_ns(self.has_plan, &self.step.plan, now);
        let sees = self.sees(now);
        let has_plan = sees
            && plan_age_ns <= self.config.plan_age_ns
            && self.step.plan.header.episode == observation.header.episode;

        let plan = has_plan.then_some(&self.step.plan);
        let planned = plan.and_then(|plan| match plan.actions() {
            [] => self.pd.propose(plan, observation),
            _ => plan.action_at(plan_age_ns),
        });
        // The driver who has taken over is the expert of the tick.
        let takeover = self.takeover(now);
        let expert = takeover.or(planned);
        let policy = answer.proposal.filter(|_| sees);
        let [expert_assessment, policy_assessment] = self.assess(sees, [expert, policy]);

        let mut choice = choose(&ArbitrationInput {
            intent,
            mode: self.config.mode,
            takeover_difference: self.config.takeover_difference,
            now,
            sees,
            plan,
            advice: self.has_advice.then_some(&self.step.advice),
            stage: answer.stage,
            takeover,
            expert,
            policy,
            expert_assessment: &expert_assessment,
            policy_assessment: &policy_assessment,
        });

        let mut transfer = self.transfer;
        let episode = self.step.observation.header.episode;
        choice.action = transfer.ease(&choice, episode, |eased| {
            let [assessment] = self.assess(sees, [Some(eased)]);
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
        step.intent = intent.code();
        step.stage = answer.stage.code();
        step.takeover_used = u32::from(takeover.is_some());
        (step.weights_version, step.weights_hash) = answer.weights;
    }

    /// The tick due at `scheduled` was decided at `decided`: a command over its
    /// deadline, one period later, becomes what `deadlines.controller` says. Returns
    /// whether the command goes out.
    pub fn complete(&mut self, scheduled: Instant, decided: Instant) -> bool {
        let timings = &mut self.step.timings;
        (timings.scheduled_ns, timings.decided_ns) = (scheduled.0, decided.0);
        let due_by = scheduled.after_ns(self.config.period_ns);
        let is_late = !self.config.is_lockstep && decided > due_by;
        !is_late || self.answer_late()
    }

    /// Does with the decided command what `deadlines.controller` says of a late one.
    /// Returns whether it goes out.
    pub fn answer_late(&mut self) -> bool {
        let policy = self.config.late;
        let command = &mut self.step.command;
        if policy != Late::Count {
            command.reason = Reason::Late.code();
        }
        if policy == Late::Brake {
            // Along the line that was decided: straight wheels leave a curve.
            command.pedal = Action::BRAKE.pedal;
            command.driver = Driver::Brake.code();
        }
        self.step.lateness = Lateness::of(policy).code();
        policy != Late::Skip
    }

    /// Records what the weights in shadow mode proposed on the tick's observation.
    pub fn record_shadow(&mut self, proposal: Option<Action>, weights: (u64, u64)) {
        let [assessment] = self.assess(true, [proposal]);
        self.step.shadow = ShadowProposal {
            proposal: Proposal::new(proposal),
            assessment,
            weights_version: weights.0,
            weights_hash: weights.1,
        };
    }

    /// The record of the last tick.
    pub fn step(&self) -> &Step {
        &self.step
    }

    /// The record of the last tick, for the process to add its timings to.
    pub fn step_mut(&mut self) -> &mut Step {
        &mut self.step
    }

    fn observation_age_ns(&self, now: Instant) -> u64 {
        age_ns(self.has_observation, &self.step.observation, now)
    }

    /// The driver's action after a takeover; `None` without one, or when the last
    /// takeover message is too old.
    fn takeover(&self, now: Instant) -> Option<Action> {
        let takeover = &self.step.takeover;
        let age_ns = now.since_ns(takeover.header.taken());
        let holds = self.config.mode == GateMode::Human && age_ns <= self.config.takeover_age_ns;
        takeover.action().filter(|_| holds)
    }

    /// The safety check of these proposals.
    fn assess<const N: usize>(
        &self,
        sees: bool,
        proposals: [Option<Action>; N],
    ) -> [Assessment; N] {
        if !sees {
            return proposals.map(|_| Assessment::default());
        }
        let (vehicle, limits) = (&self.config.vehicle, &self.config.safety);
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
        step.lateness = Lateness::OnTime.code();
        step.shadow = ShadowProposal::default();
    }
}

/// Admits what came into its place in the step, where the last good one stays
/// otherwise; with the tick's instant and the message's age limit, ns.
fn admit<M: Message>(
    input: &Newest<M>,
    held: &mut M,
    (now, limit_ns): (Instant, u64),
) -> Admission {
    match input.get() {
        None => Admission::Absent,
        Some(message) => match message.admit(now, limit_ns) {
            Ok(()) => {
                held.assign(message);
                Admission::Admitted
            }
            Err(_) => Admission::Refused,
        },
    }
}

/// The record of an admission; a refusal is counted.
fn entry(refused: &mut u64, port_ns: u64, admission: Admission) -> Entry {
    *refused += u64::from(admission == Admission::Refused);
    Entry {
        port_ns: match admission {
            Admission::Absent => 0,
            Admission::Admitted | Admission::Refused => port_ns,
        },
        admission: admission.code(),
        reserved: 0,
    }
}

fn age_ns<M: Message>(is_there: bool, message: &M, now: Instant) -> u64 {
    match is_there {
        true => now.since_ns(message.header().taken()),
        false => u64::MAX,
    }
}
