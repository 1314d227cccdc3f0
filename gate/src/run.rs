//! The gate process: asks a judge at its own pace and publishes advice.

use std::sync::mpsc::Receiver;
use std::time::Duration;

use runtime::{Arguments, HEARTBEAT_MAX, Member, SetUpError, Telemetry, Tick};
use shm_config::Instant;
use shm_config::config::Config;
use shm_config::message::{HealthState, Message, Step};
use shm_config::services::Process;
use shm_config::time::monotonic;

use crate::advice::Advisor;
use crate::judge::OpenJudge;
use crate::ports::Ports;
use crate::query::Answer;
use crate::record::{Archive, Evidence, QueryLog};

/// Interval at which a run in lockstep polls the judge, and the records' queue.
const POLL: Duration = Duration::from_millis(1);

struct Gate {
    member: Member,
    ports: Ports,
    telemetry: Telemetry,
    advisor: Advisor,
    evidence: Receiver<Evidence>,
    log: QueryLog,
    archive: Archive,
    disk_wait_ns: u64,
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
        let mut member = Member::join(Process::Gate, arguments, monotonic)?;
        let own = |error: &dyn std::fmt::Display| SetUpError::Own(error.to_string());
        let config = &member.config;
        let OpenJudge { queue, evidence } =
            OpenJudge::new(config, monotonic).map_err(|error| own(&error))?;
        let archive = Archive::open(config).map_err(|error| own(&error))?;
        let ports = Ports::open(&member.wire)?;
        let mut telemetry = Telemetry::start(&member)?;
        let advisor = Advisor::new(&config.gate, queue);
        let log = QueryLog::new(patience_ns(config));
        // Half of the time that the controller waits for this process: the other half is
        // left for the answer.
        let disk_wait_ns = (0.5e9 * config.limits.lockstep_wait_s) as u64;
        member.apply_privileges();
        telemetry.set_privileges(&member.privileges);
        telemetry.enter(HealthState::Ready, monotonic());
        Ok(Self {
            member,
            ports,
            telemetry,
            advisor,
            evidence,
            log,
            archive,
            disk_wait_ns,
        })
    }

    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn work(&mut self) {
        while !self.member.is_stopping() {
            self.ports.bell.wait(HEARTBEAT_MAX);
            let begun = monotonic();
            if let Some(step) = self.ports.steps.newest(Message::check) {
                self.consider(&step, begun);
            }
            self.telemetry.count_refused(&self.member.wire);
            self.telemetry.heartbeat(begun);
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
        if let Some(occasion) = self.advisor.ask(step) {
            self.log.asked(step, occasion, self.advisor.queue());
        }
        if lockstep {
            self.await_answers(now);
        }
        let heard = self.advisor.hear(now);
        let mut advice = self.advisor.advise(now);
        self.ports.advices.send(&mut advice);
        // After the advice, so that a slow disk does not delay it.
        self.keep_record(step, heard, now);
        self.telemetry.health.header.tick = step.header().tick;
        self.telemetry.health.state = HealthState::Running.code();
        self.telemetry.count_tick(Tick {
            due: Instant(step.timings.commanded_ns),
            released: None,
            begun,
            done: monotonic(),
        });
    }

    /// In lockstep the run's clock stands still until the judge has answered, so that
    /// runs repeat.
    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn await_answers(&mut self, now: Instant) {
        loop {
            self.advisor.collect(now);
            if self.advisor.awaited() == 0 || self.member.is_stopping() {
                return;
            }
            self.telemetry.heartbeat(monotonic());
            self.ports.bell.wait(POLL);
        }
    }

    fn keep_record(&mut self, step: &Step, heard: Option<Answer>, now: Instant) {
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
            self.log.learn(evidence);
        }
        if let Some(heard) = &heard {
            self.log.heard(heard, step.header().tick, now);
        }
        self.log.saw(step);
        let filed = self.log.filed();
        self.archive.keep(filed);
        if self.member.config.run.is_lockstep() {
            self.await_disk();
        }
        if !self.member.is_stopping() {
            self.archive.give_up();
        }
    }

    /// In lockstep the run's clock stands still until the records have room, so that none is
    /// lost: for as long as the controller still gets its next advice in time.
    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn await_disk(&mut self) {
        let begun = monotonic();
        while !self.archive.hand_over() && !self.member.is_stopping() {
            let now = monotonic();
            if now.since_ns(begun) > self.disk_wait_ns {
                return;
            }
            self.telemetry.heartbeat(now);
            // The bell is left alone: it may announce the next step.
            self.archive.wait_for_room(POLL);
        }
    }

    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn close(&mut self) {
        let filed = self.log.finish();
        self.archive.keep(filed);
        self.archive.close();
        tracing::info!(cost_usd = self.advisor.cost_usd(), "judged");
        self.telemetry.enter(HealthState::Finished, monotonic());
    }
}

/// How long an answer is waited for before its question is filed without it, ns on the
/// run's clock.
fn patience_ns(config: &Config) -> u64 {
    ((config.faulty_judge.delay_s + config.vlm.deadline_s + 10.0) * 1e9) as u64
}
