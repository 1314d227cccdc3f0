//! Observes a driving set: which process missed a tick and when, and the most late ticks
//! of the controller.

use std::cmp::Reverse;

use serde::{Deserialize, Serialize};
use shm_config::Instant;
use shm_config::message::{Health, Message, Step};
use shm_config::run::RunName;
use shm_config::services::{Process, STEP, health};
use shm_config::wire::{Subscriber, Wire};

use crate::stalls::Stalls;

/// Maximum number of misses that are recorded one by one; all are counted.
const MISSES_MAX: usize = 10_000;
/// Number of most late ticks that are recorded.
const LATEST_MAX: usize = 5;
/// Half the width of "the same second", ns.
const SECOND_NS: u64 = 500_000_000;

/// A missed or late tick, with the machine's stall in the same second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Beside {
    /// The process.
    pub process: String,
    /// Number of missed ticks; 0 for a tick that was only late.
    pub missed: u64,
    /// Time since the first step of the run, s.
    pub at_s: f64,
    /// Lateness of the tick's begin, us; `None` if only the count is known.
    pub late_us: Option<f64>,
    /// The machine's longest stall within half a second, on any core, us.
    pub stall_us: f64,
}

#[derive(Clone, Copy)]
struct Event {
    process: Process,
    missed: u64,
    at: Instant,
    late_ns: Option<u64>,
}

/// Subscribes to a running set.
pub struct Watch {
    _wire: Wire,
    steps: Subscriber<Step>,
    accounts: Vec<Account>,
    recorder: Subscriber<Health>,
    recorder_pid: Option<u32>,
    seen: Observed,
}

/// Reports of a process that publishes no steps.
struct Account {
    process: Process,
    port: Subscriber<Health>,
    /// Process id and number of missed ticks of its last report.
    before: Option<(u32, u64)>,
}

/// The observations of a run.
#[derive(Default)]
pub struct Observed {
    begun: Option<Instant>,
    skipped: Option<(u32, u64)>,
    weights_version: u64,
    /// Number of weights that proposed actions, including the first.
    pub weights: u64,
    misses: Vec<Event>,
    /// Sorted by lateness, the latest first.
    latest: Vec<Event>,
}

impl Watch {
    /// Subscribes as soon as the set's supervisor is running.
    ///
    /// # Errors
    /// If shared memory refuses.
    pub fn begin(name: &RunName) -> anyhow::Result<Self> {
        let wire = Wire::join(name, Process::Supervisor)?;
        let steps = wire.subscriber(STEP)?;
        let mut accounts = Vec::new();
        for process in [Process::World, Process::Planner] {
            accounts.push(Account {
                process,
                port: wire.subscriber(health(process))?,
                before: None,
            });
        }
        let recorder = wire.subscriber(health(Process::Recorder))?;
        Ok(Self {
            _wire: wire,
            steps,
            accounts,
            recorder,
            recorder_pid: None,
            seen: Observed::default(),
        })
    }

    /// Reads what has arrived since the last call. Call it often enough that the queue of
    /// steps does not overflow.
    pub fn look(&mut self) {
        self.steps.update_connections();
        let seen = &mut self.seen;
        while self.steps.visit(|step| seen.step(step)).is_some() {}
        self.recorder.update_connections();
        if let Some(health) = self.recorder.newest(Message::check) {
            self.recorder_pid = Some(health.header.producer);
        }
        for account in &mut self.accounts {
            account.port.update_connections();
            let Some(health) = account.port.newest(Message::check) else {
                continue;
            };
            let missed = health.skipped.max(health.late);
            let pid = health.header.producer;
            // A restarted process counts from 0 again.
            let last = account.before.filter(|(last, _)| *last == pid);
            let more = missed.saturating_sub(last.map_or(0, |(_, count)| count));
            account.before = Some((pid, missed));
            if more > 0 {
                self.seen.miss(Event {
                    process: account.process,
                    missed: more,
                    at: Instant(health.header.taken_ns),
                    late_ns: None,
                });
            }
        }
    }

    /// Whether the set drives.
    pub fn has_begun(&self) -> bool {
        self.seen.begun.is_some()
    }

    /// The process id of the recorder; `None` before its first report, or without one.
    pub fn recorder_pid(&self) -> Option<u32> {
        self.recorder_pid
    }

    /// Disconnects from the run and returns the observations.
    pub fn finish(self) -> Observed {
        self.seen
    }
}

impl Observed {
    fn step(&mut self, step: &Step) {
        let times = &step.timings;
        let scheduled = Instant(times.scheduled_ns);
        self.begun.get_or_insert(scheduled);
        let late_ns = times.started_ns.saturating_sub(times.scheduled_ns);
        let event = Event {
            process: Process::Controller,
            missed: 0,
            at: scheduled,
            late_ns: Some(late_ns),
        };
        let version = step.weights_version;
        if version != 0 && version != self.weights_version {
            self.weights += 1;
        }
        self.weights_version = version;
        let pid = step.header.producer;
        let last = self.skipped.filter(|(last, _)| *last == pid);
        let missed = step
            .skipped
            .saturating_sub(last.map_or(0, |(_, count)| count));
        self.skipped = Some((pid, step.skipped));
        if missed > 0 {
            self.miss(Event { missed, ..event });
        }
        // A tick without an observation is late because it waits for one.
        let waited = times.released_ns == 0;
        let is_among = self.latest.len() < LATEST_MAX
            || self
                .latest
                .last()
                .is_some_and(|last| last.late_ns < event.late_ns);
        if waited || !is_among {
            return;
        }
        self.latest.push(event);
        self.latest.sort_by_key(|event| Reverse(event.late_ns));
        self.latest.truncate(LATEST_MAX);
    }

    fn miss(&mut self, event: Event) {
        if self.misses.len() < MISSES_MAX {
            self.misses.push(event);
        }
    }

    /// Each miss, and each of the most late ticks, with the machine's stall in the same
    /// second.
    pub fn beside(&self, stalls: &Stalls) -> (Vec<Beside>, Vec<Beside>) {
        let begun = self.begun.unwrap_or_default();
        let beside = |event: &Event| Beside {
            process: event.process.word().into(),
            missed: event.missed,
            at_s: event.at.since_ns(begun) as f64 / 1e9,
            late_us: event.late_ns.map(|ns| ns as f64 / 1e3),
            stall_us: stalls.near(event.at, SECOND_NS) as f64 / 1e3,
        };
        let all = |events: &[Event]| events.iter().map(beside).collect();
        (all(&self.misses), all(&self.latest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_miss_stands_beside_the_stall_of_its_second() {
        let begun = Instant(1_000_000_000);
        let mut stalls = Stalls::from(begun);
        stalls.note(begun.after_ns(2_000_000_000), 9_000_000);
        let mut seen = Observed::default();
        let mut step = Step::default();
        step.header.producer = 7;
        for (tick, late_ns, skipped) in [(0, 10_000, 0), (20, 12_000_000, 1), (40, 20_000, 1)] {
            step.timings.scheduled_ns = begun.after_ns(tick * 100_000_000).0;
            step.timings.released_ns = step.timings.scheduled_ns;
            step.timings.started_ns = step.timings.scheduled_ns + late_ns;
            step.skipped = skipped;
            seen.step(&step);
        }
        let (misses, latest) = seen.beside(&stalls);
        assert_eq!(misses.len(), 1);
        assert_eq!(misses[0].stall_us, 9_000.0);
        assert_eq!((misses[0].at_s, misses[0].late_us), (2.0, Some(12_000.0)));
        assert_eq!(latest.len(), 3);
        assert_eq!((latest[0].at_s, latest[1].stall_us), (2.0, 0.0));
    }
}
