//! The stop of a process set: the car is braked to a stand first.

use rustix::process::Signal;
use shm_config::Instant;
use shm_config::config::Supervisor;
use shm_config::services::Process;

use crate::set::process_set::ProcessSet;

/// How long processes may take to end when no car is left to brake, ns. They only
/// publish their last telemetry, which takes about 10 ms.
const NO_CAR_NS: u64 = 1_000_000_000;

/// How long a learner may take when only it still lives, ns: it finishes its block of
/// updates, which takes seconds on a busy machine, and saves its state.
const LEARNER_NS: u64 = 60_000_000_000;

/// How long a recorder may take when only it and the learner still live, ns: it writes what
/// is in memory, and its files' indexes.
const RECORDER_NS: u64 = 10_000_000_000;

/// The order in which the processes are asked to end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// The controller first, which brakes the car to a stand; then the others.
    CarFirst,
    /// All at once: without a world there is no car to brake.
    NoCar,
}

impl Order {
    /// The order for a set as it is now.
    pub fn of(set: &ProcessSet) -> Self {
        let driven = set.lives(Process::World) && set.lives(Process::Controller);
        if driven { Self::CarFirst } else { Self::NoCar }
    }
}

/// A stop in progress.
#[derive(Debug)]
pub struct Stop {
    since: Instant,
    others_asked: bool,
    killed: bool,
    half_ns: u64,
    limit_ns: u64,
}

impl Stop {
    /// Starts to stop the set.
    pub fn begin(set: &ProcessSet, limits: &Supervisor, now: Instant) -> Self {
        let order = Order::of(set);
        let stop_ns = (limits.stop_s * 1e9) as u64;
        match order {
            Order::CarFirst => set.signal(Process::Controller, Signal::TERM),
            Order::NoCar => set.signal_all(Signal::TERM),
        }
        Self {
            since: now,
            others_asked: order == Order::NoCar,
            killed: false,
            half_ns: stop_ns / 2,
            limit_ns: match order {
                Order::CarFirst => stop_ns,
                Order::NoCar => stop_ns.min(NO_CAR_NS),
            },
        }
    }

    /// Takes the next step when it is due. Call it after the set was reaped.
    pub fn advance(&mut self, set: &ProcessSet, now: Instant) {
        let passed_ns = now.since_ns(self.since);
        let car_rests = !set.lives(Process::Controller) || passed_ns >= self.half_ns;
        if car_rests && !self.others_asked {
            self.others_asked = true;
            set.signal_all(Signal::TERM);
        }
        let driving = [
            Process::World,
            Process::Planner,
            Process::Controller,
            Process::Gate,
        ];
        let is_driven = driving.into_iter().any(|process| set.lives(process));
        let lives = |process| !is_driven && set.lives(process);
        let limit_ns = match (lives(Process::Learner), lives(Process::Recorder)) {
            (true, _) => self.limit_ns.max(LEARNER_NS),
            (false, true) => self.limit_ns.max(RECORDER_NS),
            (false, false) => self.limit_ns,
        };
        if passed_ns >= limit_ns {
            self.kill(set);
        }
    }

    /// Kills all living processes, once.
    pub fn kill(&mut self, set: &ProcessSet) {
        if !self.killed && !set.is_empty() {
            self.killed = true;
            set.signal_all(Signal::KILL);
        }
    }

    /// Whether a process had to be killed.
    pub fn was_forced(&self) -> bool {
        self.killed
    }
}
