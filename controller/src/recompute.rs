use shm_config::Instant;
use shm_config::config::Config;
use shm_config::difference::{Difference, first_difference};
use shm_config::message::{Admission, Before, Entry, Header, MOTION_AT_REST, Step};

use crate::{Arbiter, ArbiterConfig, Inputs, Policy, PolicyAnswer, PolicySlot};

/// Recomputes recorded ticks, each from its step alone and in any order.
///
/// What came from outside the tick is taken from the step: the state before it, the
/// messages, the clock reads, the tick's number, the intent, and the numbers that the
/// ports gave. A refused message is not in the step; that it was refused is. All else
/// is computed by the [`Arbiter`] that drives.
pub struct Recomputer {
    arbiter: Arbiter,
    policies: Policies,
    /// A learner of the run trained a policy that takes how bodies move.
    trains_motion: bool,
}

/// Where the policies' proposals come from.
enum Policies {
    /// From the steps.
    Recorded,
    /// From this one, in place of the active one.
    Instead(Box<PolicySlot>),
    /// From those of these whose weights a step names; of others, from the step.
    Known(Vec<PolicySlot>),
}

impl Recomputer {
    /// For the steps of a run of this configuration; the policies' proposals are taken
    /// from the steps.
    pub fn new(config: &Config) -> Self {
        Self {
            arbiter: Arbiter::new(ArbiterConfig::from(config)),
            policies: Policies::Recorded,
            trains_motion: config.learner.trains_motion(),
        }
    }

    /// The same with a policy that is asked again: in place of the active one, and of
    /// the one in shadow mode where that had its hash.
    pub fn with_policy(config: &Config, policy: Box<dyn Policy>) -> Self {
        Self {
            policies: Policies::Instead(Box::new(PolicySlot::new(Some(policy)))),
            ..Self::new(config)
        }
    }

    /// The same with the run's policies, each of which is asked again where a step names
    /// its weights. An answer that a step lacks came too late or was not finite: that is
    /// taken from the step.
    pub fn with_policies(config: &Config, policies: Vec<Box<dyn Policy>>) -> Self {
        let slots = policies
            .into_iter()
            .map(|policy| PolicySlot::new(Some(policy)));
        Self {
            policies: Policies::Known(slots.collect()),
            ..Self::new(config)
        }
    }

    /// The state after the tick that was computed last: the one before the next.
    pub fn after(&self) -> Before {
        self.arbiter.state()
    }

    /// Computes the tick of a recorded step again.
    pub fn recompute(&mut self, recorded: &Step) -> &Step {
        let now = recorded.header.taken();
        self.arbiter.restore(&recorded.before, held(recorded));
        self.arbiter.admit(&inputs(recorded), now);
        if self.follows_nothing(recorded) {
            self.arbiter.step_mut().motion.fill(MOTION_AT_REST);
        }
        self.repeat_refusals(recorded);
        let answer = self.answer(recorded, now);
        let (tick, intent) = (recorded.header.tick, recorded.intent());
        self.arbiter.decide(tick, now, intent, &answer);
        let timings = recorded.timings;
        let [scheduled, decided] = [timings.scheduled_ns, timings.decided_ns].map(Instant);
        self.arbiter.complete(scheduled, decided);
        self.shadow(recorded);
        let step = self.arbiter.step_mut();
        step.timings = timings;
        let header = &recorded.command.header;
        (step.command.header.sequence, step.command.header.producer) =
            (header.sequence, header.producer);
        step
    }

    /// Computes the tick again and compares all bytes: the first field that differs,
    /// with its recorded and its recomputed value.
    pub fn first_difference(&mut self, recorded: &Step) -> Option<Difference> {
        first_difference(recorded, self.recompute(recorded))
    }

    /// The tick took an observation, and none of its policies, which are known, takes how
    /// bodies move. Otherwise that is the step's: it comes from the scans before.
    fn follows_nothing(&self, recorded: &Step) -> bool {
        let Policies::Known(policies) = &self.policies else {
            return false;
        };
        let is_known =
            |hash: u64| hash == 0 || policies.iter().any(|policy| policy.weights().1 == hash);
        recorded.observation_entry.admission() == Admission::Admitted
            && !self.trains_motion
            && is_known(recorded.weights_hash)
            && is_known(recorded.shadow.weights_hash)
            && policies.iter().all(|policy| !policy.takes_motion())
    }

    /// A message that the tick refused is not in its step.
    fn repeat_refusals(&mut self, recorded: &Step) {
        let step = self.arbiter.step_mut();
        let entries = [
            (&mut step.observation_entry, &recorded.observation_entry),
            (&mut step.plan_entry, &recorded.plan_entry),
            (&mut step.advice_entry, &recorded.advice_entry),
            (&mut step.takeover_entry, &recorded.takeover_entry),
        ];
        for (entry, recorded) in entries {
            if recorded.admission() == Admission::Refused {
                *entry = *recorded;
                step.refused += 1;
            }
        }
    }

    /// What the policies said: recorded, or asked again.
    fn answer(&mut self, recorded: &Step, now: Instant) -> PolicyAnswer {
        let sees = self.arbiter.sees(now);
        let step = self.arbiter.step();
        let mut answer = PolicyAnswer {
            stage: recorded.stage(),
            proposal: recorded.policy.action(),
            weights: (recorded.weights_version, recorded.weights_hash),
        };
        match &mut self.policies {
            Policies::Instead(policy) if !is_shadow(policy, recorded) => {
                return policy.answer(step, sees);
            }
            Policies::Known(policies) if answer.proposal.is_some() => {
                if let Some(policy) = of_hash(policies, recorded.weights_hash) {
                    answer.proposal = policy.answer(step, sees).proposal;
                }
            }
            Policies::Recorded | Policies::Instead(_) | Policies::Known(_) => {}
        }
        answer
    }

    /// What the policy in shadow mode said, likewise.
    fn shadow(&mut self, recorded: &Step) {
        let shadow = &recorded.shadow;
        if shadow.weights_version == 0 {
            return;
        }
        let step = self.arbiter.step();
        let said = shadow.proposal.action();
        let again = match &mut self.policies {
            Policies::Instead(policy) => {
                Some(&mut **policy).filter(|policy| is_shadow(policy, recorded))
            }
            Policies::Known(policies) if said.is_some() => of_hash(policies, shadow.weights_hash),
            Policies::Recorded | Policies::Known(_) => None,
        };
        let proposal = again.map_or(said, |policy| policy.propose(step));
        let weights = (shadow.weights_version, shadow.weights_hash);
        self.arbiter.record_shadow(proposal, weights);
    }
}

/// The policy of these weights.
fn of_hash(policies: &mut [PolicySlot], hash: u64) -> Option<&mut PolicySlot> {
    policies
        .iter_mut()
        .find(|policy| policy.weights().1 == hash)
}

/// The policy was in shadow mode in this tick, and not active.
fn is_shadow(policy: &PolicySlot, recorded: &Step) -> bool {
    let (_, hash) = policy.weights();
    recorded.shadow.weights_hash == hash && recorded.weights_hash != hash
}

/// The controller's step before the tick admitted anything, as far as the tick reads
/// it: the numbers of the ports and the messages that were admitted before.
fn held(recorded: &Step) -> Step {
    let mut step = Step {
        header: Header {
            sequence: recorded.header.sequence,
            producer: recorded.header.producer,
            ..Header::default()
        },
        skipped: recorded.skipped,
        // Of the scans before it, which are not in the step.
        motion: recorded.motion,
        ..Step::default()
    };
    let is_held = |entry: &Entry| entry.admission() != Admission::Admitted;
    if is_held(&recorded.observation_entry) {
        step.observation = recorded.observation;
    }
    if is_held(&recorded.plan_entry) {
        step.plan = recorded.plan;
    }
    if is_held(&recorded.advice_entry) {
        step.advice = recorded.advice;
    }
    if is_held(&recorded.takeover_entry) {
        step.takeover = recorded.takeover;
    }
    step
}

/// The messages that the tick admitted.
fn inputs(recorded: &Step) -> Inputs {
    let mut inputs = Inputs {
        refused: recorded.refused_at_ports,
        ..Inputs::default()
    };
    let came = |entry: &Entry| entry.admission() == Admission::Admitted;
    if came(&recorded.observation_entry) {
        inputs.observation.keep(&recorded.observation);
    }
    if came(&recorded.plan_entry) {
        inputs.plan.keep(&recorded.plan);
    }
    if came(&recorded.advice_entry) {
        inputs.advice.keep(&recorded.advice);
    }
    if came(&recorded.takeover_entry) {
        inputs.takeover.keep(&recorded.takeover);
    }
    inputs.admitted.observation_ns = recorded.observation_entry.port_ns;
    inputs.admitted.plan_ns = recorded.plan_entry.port_ns;
    inputs.admitted.advice_ns = recorded.advice_entry.port_ns;
    inputs.admitted.takeover_ns = recorded.takeover_entry.port_ns;
    inputs
}
