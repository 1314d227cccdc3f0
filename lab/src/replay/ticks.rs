//! The controller's ticks, safety and the policy's proposals included, each recomputed from
//! its step.

use std::sync::Mutex;

use controller::{Arbiter, ArbiterConfig, Policy, Recomputer, Terms};
use rayon::prelude::*;
use shm_config::config::{Clock as RunClock, Config};
use shm_config::layout::Layout;
use shm_config::message::{Before, Header, Lateness, Message, Step};
use shm_config::services::Process;
use stack::Clock;

use super::findings::{Findings, Found};
use super::messages::{Channel, Messages, Stretch, key, taken};
use super::source::PolicyBytes;

const PROCESS: Process = Process::Controller;
/// Ticks that a thread recomputes at a time.
const CHUNK: usize = 128;
/// A number so far beyond the last recorded one is no message that the recorder missed at
/// its end.
const BEYOND: u64 = 64;

/// Recomputes the controller's ticks.
pub struct Ticks {
    config: Config,
    clock: Clock,
    policies: Vec<PolicyBytes>,
    idle: Mutex<Vec<Recomputer>>,
    last: Option<Box<Step>>,
}

impl Ticks {
    /// Of a run of this configuration.
    pub fn new(config: &Config, clock: Clock) -> Self {
        Self {
            config: config.clone(),
            clock,
            policies: Vec::new(),
            idle: Mutex::default(),
            last: None,
        }
    }

    /// The weights of these steps whose files are asked for now for the first time.
    pub fn unknown_weights(&self, messages: &Messages) -> Vec<u64> {
        let mut hashes: Vec<u64> = (messages.steps.all.iter())
            .flat_map(|step| [step.weights_hash, step.shadow.weights_hash])
            .filter(|hash| *hash != 0)
            .collect();
        hashes.sort_unstable();
        hashes.dedup();
        hashes.retain(|hash| self.policies.iter().all(|policy| policy.hash != *hash));
        hashes
    }

    /// Adds a policy of the run.
    ///
    /// # Errors
    /// When it is refused.
    pub fn add_policy(&mut self, policy: PolicyBytes) -> anyhow::Result<()> {
        build(&policy, &self.config, self.clock)?;
        self.policies.push(policy);
        self.idle = Mutex::default();
        Ok(())
    }

    /// A recomputer that no thread uses.
    fn recomputer(&self) -> Recomputer {
        let idle = self.idle.lock().ok().and_then(|mut idle| idle.pop());
        idle.unwrap_or_else(|| {
            let policies = self.policies.iter();
            // Each of them was built before.
            let built = policies.filter_map(|policy| build(policy, &self.config, self.clock).ok());
            Recomputer::with_policies(&self.config, built.collect())
        })
    }

    /// Recomputes the ticks of a stretch from this tick on.
    pub fn check(&mut self, stretch: &Stretch, from: u64, findings: &mut Findings) {
        let steps = &stretch.now.steps.all;
        let chunks: Vec<_> = (0..steps.len()).step_by(CHUNK).collect();
        let found: Vec<(Vec<Found>, u64)> = chunks
            .into_par_iter()
            .map(|first| {
                let mut recomputer = self.recomputer();
                let last = steps.len().min(first + CHUNK);
                let mut before = match first.checked_sub(1) {
                    Some(index) => Some(&steps[index]),
                    None => self.last.as_deref(),
                };
                let mut found = Vec::new();
                let mut lost = 0;
                let mut after = None;
                for step in steps[first..last].iter() {
                    if step.header.tick >= from {
                        let check = Check {
                            stretch,
                            step,
                            before,
                        };
                        found.extend(check.run(&self.config, &mut recomputer, &mut after));
                        lost += u64::from(check.is_after_gap());
                    }
                    before = Some(step);
                }
                if let Ok(mut idle) = self.idle.lock() {
                    idle.push(recomputer);
                }
                (found, lost)
            })
            .collect();
        let counted = steps.iter().filter(|step| step.header.tick >= from);
        findings.count(PROCESS, counted.count());
        for (found, lost) in found {
            findings.add(PROCESS, found);
            findings.tally(PROCESS).unknown += lost;
        }
        if let Some(step) = steps.last() {
            self.last = Some(Box::new(*step));
        }
    }
}

/// A policy as it is asked in the tick, without its deadline.
pub fn build(
    policy: &PolicyBytes,
    config: &Config,
    clock: Clock,
) -> Result<Box<dyn Policy>, policy::Refusal> {
    let mut config = config.clone();
    // This machine's speed does not matter here.
    config.run.clock = RunClock::Lockstep;
    let terms = Terms {
        config: &config,
        version: 1,
        clock,
    };
    controller::build(&policy.bytes, &terms)
}

/// One recorded tick beside the one before it.
struct Check<'a> {
    stretch: &'a Stretch<'a>,
    step: &'a Step,
    before: Option<&'a Step>,
}

impl Check<'_> {
    /// The step that the controller sent just before this one.
    fn previous(&self) -> Option<&Step> {
        let Header {
            producer, sequence, ..
        } = self.step.header;
        let is_previous = |step: &&Step| {
            step.header.producer == producer && step.header.sequence.wrapping_add(1) == sequence
        };
        self.before
            .filter(is_previous)
            .filter(|step| step.check().is_ok())
    }

    /// Whether steps of the same controller are missing before this one.
    fn is_after_gap(&self) -> bool {
        let same = |step: &&Step| step.header.producer == self.step.header.producer;
        self.before.filter(same).is_some() && self.previous().is_none()
    }

    /// The first difference of the tick. `after` is the state after the tick before it,
    /// where it was computed, and becomes the one after this tick.
    fn run(
        &self,
        config: &Config,
        recomputer: &mut Recomputer,
        after: &mut Option<Before>,
    ) -> Option<Found> {
        let copies = self.copies().or_else(|| self.order(config));
        let known = after.take();
        let state = copies.or_else(|| self.state(config, recomputer, known));
        let invalid = state.or_else(|| self.invalid());
        invalid.or_else(|| {
            let again = recomputer.recompute(self.step);
            let found = Found::in_message(PROCESS, self.stretch.number, "", (self.step, again));
            *after = Some(recomputer.after());
            found
        })
    }

    /// The messages in the step against those that were recorded for themselves.
    fn copies(&self) -> Option<Found> {
        let step = self.step;
        self.input("observation", &step.observation, |all| &all.observations)
            .or_else(|| self.input("plan", &step.plan, |all| &all.plans))
            .or_else(|| self.input("advice", &step.advice, |all| &all.advice))
            .or_else(|| self.input("takeover", &step.takeover, |all| &all.takeovers))
            .or_else(|| {
                let is_sent = step.lateness != Lateness::HeldBack.code();
                is_sent
                    .then(|| self.copy("command", &step.command, |all| &all.commands))
                    .flatten()
            })
    }

    /// An input in the step against the recorded one of its number; against the default where
    /// none came yet.
    fn input<M: Message + Default>(
        &self,
        name: &str,
        copy: &M,
        channel: impl Fn(&Messages) -> &Channel<M>,
    ) -> Option<Found> {
        if key(copy.header()) != (0, 0) {
            return self.copy(name, copy, channel);
        }
        let found = shm_config::difference::first_difference(copy, &M::default())?;
        let at = (self.stretch.number, &self.step.header);
        let field = format!("{name}.{}", found.field);
        Some(Found::new(PROCESS, at, field, (found.left, found.right)))
    }

    /// A message in the step against the recorded one of its number.
    fn copy<M: Message>(
        &self,
        name: &str,
        copy: &M,
        channel: impl Fn(&Messages) -> &Channel<M>,
    ) -> Option<Found> {
        let (producer, sequence) = key(copy.header());
        let at = (self.stretch.number, &self.step.header);
        let by_number = self
            .stretch
            .find(|all| channel(all).find((producer, sequence)));
        let by_time = || {
            self.stretch
                .find(|all| channel(all).at(taken(copy.header())))
        };
        if let Some(own) = by_number.or_else(by_time) {
            // The copy differs from what its sender said.
            let found = shm_config::difference::first_difference(copy, own)?;
            let field = format!("{name}.{}", found.field);
            return Some(Found::new(PROCESS, at, field, (found.left, found.right)));
        }
        let everywhere = [
            self.stretch.now,
            self.stretch.beside[0],
            self.stretch.beside[1],
        ];
        let recorded = || everywhere.iter().filter(|all| !channel(all).all.is_empty());
        let numbers = || recorded().filter_map(|all| channel(all).numbers(producer));
        let most = numbers().map(|(_, most)| most).max();
        let is_lost = recorded().next().is_none()
            || most.is_some_and(|most| sequence <= most.saturating_add(BEYOND));
        (!is_lost).then(|| {
            let said = format!("message {sequence} of process {producer}");
            let field = format!("{name}.header");
            Found::new(PROCESS, at, field, (said, "no such message is recorded"))
        })
    }

    /// The instants that the tick notes, which the loop reads in this order.
    fn order(&self, config: &Config) -> Option<Found> {
        let (step, times) = (self.step, &self.step.timings);
        let at = (self.stretch.number, &step.header);
        let wrong = |field: &str, recorded: u64, least: u64| {
            (recorded < least).then(|| {
                let least = format!("at least {least}");
                Found::new(PROCESS, at, format!("timings.{field}"), (recorded, least))
            })
        };
        if !config.run.is_lockstep() && step.header.taken_ns != times.planned_ns {
            let values = (times.planned_ns, step.header.taken_ns);
            return Some(Found::new(PROCESS, at, "timings.planned_ns", values));
        }
        wrong("planned_ns", times.planned_ns, times.started_ns)
            .or_else(|| wrong("decided_ns", times.decided_ns, times.planned_ns))
            .or_else(|| wrong("commanded_ns", times.commanded_ns, times.decided_ns))
    }

    /// A step that no reader would admit.
    fn invalid(&self) -> Option<Found> {
        let refusal = self.step.check().err()?;
        let at = (self.stretch.number, &self.step.header);
        Some(Found::new(
            PROCESS,
            at,
            "step",
            (refusal, "a step that is admitted"),
        ))
    }

    /// The state before the tick against the one after the tick before it.
    fn state(
        &self,
        config: &Config,
        recomputer: &mut Recomputer,
        after: Option<Before>,
    ) -> Option<Found> {
        let expected = match self.previous() {
            Some(previous) => after.unwrap_or_else(|| {
                recomputer.recompute(previous);
                recomputer.after()
            }),
            None if self.step.header.sequence == 1 => {
                Arbiter::new(ArbiterConfig::from(config)).state()
            }
            None => return None,
        };
        if self.step.before.as_bytes() == expected.as_bytes() {
            return None;
        }
        let found = shm_config::difference::first_difference(&self.step.before, &expected)?;
        let at = (self.stretch.number, &self.step.header);
        let field = format!("before.{}", found.field);
        Some(Found::new(PROCESS, at, field, (found.left, found.right)))
    }
}
