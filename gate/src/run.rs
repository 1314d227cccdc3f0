//! The gate process: asks a judge at its own pace and publishes advice.

use std::sync::mpsc::Receiver;
use std::time::Duration;

use process::{Arguments, Member, Pulse, SetUpError, Tick};
use shm_config::Instant;
use shm_config::config::{Config, GateMode};
use shm_config::message::{HealthState, Message, Step};
use shm_config::services::Process;
use shm_config::time::monotonic;

use crate::advice::{Counsel, Heard};
use crate::judge::{Bench, as_the_paper};
use crate::ports::Ports;
use crate::record::{Archive, Clerk, Evidence};

/// How long the gate sleeps at most before it says how it does.
const NAP: Duration = Duration::from_millis(20);
/// From look to look at a judge that a run in lockstep waits for.
const LOOK: Duration = Duration::from_millis(1);

struct Gate {
    member: Member,
    ports: Ports,
    pulse: Pulse,
    counsel: Counsel,
    evidence: Receiver<Evidence>,
    clerk: Clerk,
    archive: Archive,
}

/// Joins the run and publishes advice until the run stops.
///
/// # Errors
/// When the process cannot be set up.
pub fn run(arguments: &Arguments) -> Result<(), SetUpError> {
    let mut gate = Gate::open(arguments)?;
    gate.work();
    gate.close();
    Ok(())
}

impl Gate {
    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn open(arguments: &Arguments) -> Result<Self, SetUpError> {
        let mut member = Member::join(Process::Gate, arguments)?;
        let own = |error: &dyn std::fmt::Display| SetUpError::Own(error.to_string());
        member.config = as_the_paper(member.config);
        let config = &member.config;
        let Bench { docket, evidence } =
            Bench::open(config, monotonic).map_err(|error| own(&error))?;
        let archive = Archive::open(config).map_err(|error| own(&error))?;
        let ports = Ports::open(&member.wire)?;
        let mut pulse = Pulse::start(&member)?;
        let counsel = Counsel::new(&config.gate, docket);
        let jurors: &[_] = match config.gate.mode {
            GateMode::Committee => &config.gate.committee,
            _ => &[],
        };
        let clerk = Clerk::new(patience_ns(config), jurors);
        member.claim_rights();
        pulse.set_rights(&member.rights);
        pulse.enter(HealthState::Ready, monotonic());
        Ok(Self {
            member,
            ports,
            pulse,
            counsel,
            evidence,
            clerk,
            archive,
        })
    }

    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn work(&mut self) {
        while !self.member.is_stopping() {
            self.ports.bell.wait(NAP);
            let begun = monotonic();
            if let Some(step) = self.ports.steps.newest(Message::check) {
                self.consider(&step, begun);
            }
            self.pulse.count_refused(&self.member.wire);
            self.pulse.beat(begun);
            self.ports.update_connections();
        }
    }

    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn consider(&mut self, step: &Step, begun: Instant) {
        let lockstep = self.member.config.run.is_lockstep();
        let now = match lockstep {
            true => step.header().taken(),
            false => begun,
        };
        if let Some((question, occasion)) = self.counsel.ask(step) {
            self.clerk.asked(&question, occasion, self.counsel.kind());
        }
        if lockstep {
            self.await_answers(now);
        }
        let heard = self.counsel.hear(now);
        self.keep_record(step, heard, now);
        let mut advice = self.counsel.advise(now);
        self.ports.advices.send(&mut advice);
        self.pulse.health.header.tick = step.header().tick;
        self.pulse.health.state = HealthState::Running.code();
        self.pulse.count_tick(Tick {
            due: Instant(step.timings.commanded_ns),
            released: None,
            begun,
            done: monotonic(),
        });
    }

    /// In lockstep the run's time stands while a judge thinks: runs repeat.
    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn await_answers(&mut self, now: Instant) {
        loop {
            self.counsel.collect(now);
            if self.counsel.awaited() == 0 || self.member.is_stopping() {
                return;
            }
            self.pulse.beat(monotonic());
            self.ports.bell.wait(LOOK);
        }
    }

    fn keep_record(&mut self, step: &Step, heard: Option<Heard>, now: Instant) {
        while let Ok(evidence) = self.evidence.try_recv() {
            if !evidence.fault.is_empty() {
                tracing::warn!(
                    tick = evidence.key.1,
                    fault = evidence.fault,
                    "no preference"
                );
            }
            if let Some(trouble) = &evidence.trouble {
                self.archive.warn(trouble);
            }
            self.clerk.learn(evidence);
        }
        if let Some(heard) = &heard {
            self.clerk.heard(heard, step.header().tick, now);
        }
        self.clerk.saw(step);
        let filed = self.clerk.filed();
        self.archive.keep(filed);
    }

    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn close(&mut self) {
        let filed = self.clerk.finish();
        self.archive.keep(filed);
        self.archive.close();
        tracing::info!(cost_usd = self.counsel.cost_usd(), "judged");
        self.pulse.enter(HealthState::Finished, monotonic());
    }
}

/// How long an answer is waited for on the run's clock before its question is
/// filed without it, ns.
fn patience_ns(config: &Config) -> u64 {
    ((config.gate.delay_s + config.vlm.deadline_s + 10.0) * 1e9) as u64
}
