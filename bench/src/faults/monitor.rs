//! Watches a set from outside: reads what a vehicle reads, and which processes live.

use shm_config::Instant;
use shm_config::message::{Command, Driver, Fault, Health, HealthState, Message, Progress, Step};
use shm_config::run::RunName;
use shm_config::services::{self, COMMAND, FAULT, PROGRESS, Process, STEP};
use shm_config::wire::{Publisher, Subscriber, Wire, WireError};

use super::ledger::{Ledger, Limits, is_fresh};
use stack::Clock;

/// The processes that the supervisor starts.
pub const CHILDREN: [Process; 5] = [
    Process::World,
    Process::Planner,
    Process::Controller,
    Process::Gate,
    Process::Learner,
];

/// Commands read in one call: a flood must not block the watcher.
const COMMANDS_MAX: usize = 16;

/// The newest health report of one process.
struct HealthReader {
    process: Process,
    port: Subscriber<Health>,
    newest: Option<Health>,
}

/// The outcome of one fault so far.
#[derive(Debug, Clone)]
pub struct Trial {
    /// Instant of the fault.
    pub injected: Instant,
    /// Instant at which the fault was over, if it lasts; else the instant of the fault.
    pub over: Option<Instant>,
    /// Instant at which the last command before the fault was given.
    pub before: Instant,
    /// An instant of the grid before the fault.
    pub anchor: Instant,
    /// Process id of the controller that the fault kills. Each further step of it moves
    /// the fault's instant: a process executes a fault order with a delay.
    pub dying: Option<u32>,
    /// The first safe command after the fault: its instant, and whether it is the brake.
    pub command: Option<(Instant, bool)>,
    /// Instant of the first command based on inputs that came after the fault was over.
    pub fresh: Option<Instant>,
}

/// Subscribers to a running set, with the ledger of what they have read.
pub struct Monitor {
    steps: Subscriber<Step>,
    commands: Subscriber<Command>,
    progress: Subscriber<Progress>,
    health: Vec<HealthReader>,
    /// Counts of everything since the watcher joined.
    pub ledger: Ledger,
    /// Consecutive steps on fresh inputs.
    pub fresh_in_row: u32,
    /// Publisher of fault orders: a process that receives one fails as ordered.
    pub orders: Publisher<Fault>,
    trial: Option<Trial>,
    /// The limits of the run.
    pub limits: Limits,
    /// The shared memory connection; dropped after the ports.
    pub wire: Wire,
}

impl Monitor {
    /// Joins a running set; `supervisor` is its supervisor's process id.
    ///
    /// # Errors
    /// If shared memory refuses.
    pub fn join(name: &RunName, supervisor: u32, limits: Limits) -> Result<Self, WireError> {
        let wire = Wire::join(name, Process::Learner)?;
        // Messages that the campaign itself forges are not read back.
        wire.follow(supervisor)?;
        wire.await_named(Process::Supervisor, supervisor)?;
        let health = CHILDREN.map(|process| {
            let port = wire.subscriber(services::health(process))?;
            Ok(HealthReader {
                process,
                port,
                newest: None,
            })
        });
        Ok(Self {
            steps: wire.subscriber(STEP)?,
            commands: wire.subscriber(COMMAND)?,
            progress: wire.subscriber(PROGRESS)?,
            health: health.into_iter().collect::<Result<_, WireError>>()?,
            ledger: Ledger::new(limits, std::process::id()),
            fresh_in_row: 0,
            orders: wire.publisher(FAULT)?,
            trial: None,
            limits,
            wire,
        })
    }

    /// Reads everything that has arrived. Never waits.
    pub fn look(&mut self, clock: Clock) {
        self.steps.update_connections();
        self.commands.update_connections();
        self.progress.update_connections();
        self.orders.update_connections();
        for reader in &mut self.health {
            reader.port.update_connections();
            // Reports of a dead process and of its successor.
            while let Some(health) = reader.port.receive() {
                let newer = reader
                    .newest
                    .is_none_or(|newest| newest.header.taken_ns <= health.header.taken_ns);
                if newer {
                    reader.newest = Some(health);
                }
            }
        }
        while let Some(step) = self.steps.receive() {
            self.take(&step);
        }
        for _ in 0..COMMANDS_MAX {
            let Some(command) = self.commands.receive() else {
                break;
            };
            // The clock is read after the command was received: the watcher may be delayed.
            self.ledger.command(&command, clock());
        }
        while let Some(progress) = self.progress.receive() {
            self.ledger.obeyed(progress.command_age_max_ns);
        }
    }

    fn take(&mut self, step: &Step) {
        let is_safe = self.ledger.step(step);
        let is_fresh_now = is_fresh(step, Instant(0)) && step.observation_age_ns < u64::MAX;
        self.fresh_in_row = match is_fresh_now {
            true => self.fresh_in_row + 1,
            false => 0,
        };
        let Some(trial) = &mut self.trial else {
            return;
        };
        let given = step.command.header.taken();
        if given <= trial.injected {
            trial.before = trial.before.max(given);
            return;
        }
        if trial.dying == Some(step.header.producer) {
            trial.injected = Instant(step.timings.commanded_ns);
            trial.before = given;
            return;
        }
        // A process that was stopped within a tick publishes a command that is too old to obey.
        let handed = Instant(step.timings.commanded_ns);
        let obeyed = handed.since_ns(given) <= self.limits.command_age_ns;
        if is_safe && obeyed && trial.command.is_none() {
            let brakes = step.driver() == Driver::Brake;
            trial.command = Some((handed, brakes));
        }
        if let Some(over) = trial.over
            && trial.fresh.is_none()
            && is_fresh(step, over)
        {
            trial.fresh = Some(handed);
        }
    }

    /// Begins a trial at the instant of a fault. The ports have been read just before.
    pub fn begin(&mut self, injected: Instant) {
        let newest = self.ledger.newest();
        self.trial = Some(Trial {
            injected,
            before: newest.map_or(injected, |step| step.command.header.taken()),
            anchor: newest.map_or(injected, |step| Instant(step.timings.scheduled_ns)),
            dying: None,
            over: None,
            command: None,
            fresh: None,
        });
    }

    /// The fault kills the controller of this process id.
    pub fn expect_death(&mut self, pid: Option<i32>) {
        if let Some(trial) = &mut self.trial {
            trial.dying = pid.and_then(|pid| u32::try_from(pid).ok());
        }
    }

    /// The fault is over, as far as the campaign controls it.
    pub fn over(&mut self, now: Instant) {
        if let Some(trial) = &mut self.trial {
            trial.over = Some(now);
        }
    }

    /// The trial in progress.
    pub fn trial(&self) -> Option<&Trial> {
        self.trial.as_ref()
    }

    /// Ends the trial and returns it.
    pub fn take_trial(&mut self) -> Option<Trial> {
        self.trial.take()
    }

    /// The process id that a process reported last.
    pub fn pid(&self, process: Process) -> Option<i32> {
        let health = self.newest(process)?;
        i32::try_from(health.header.producer).ok()
    }

    /// Whether the process was up and reported after an instant.
    pub fn is_up(&self, process: Process, after: Instant) -> bool {
        self.newest(process).is_some_and(|health| {
            let state = HealthState::from_code(health.state);
            let up = matches!(state, Some(HealthState::Ready | HealthState::Running));
            up && health.header().taken() > after
        })
    }

    fn newest(&self, process: Process) -> Option<&Health> {
        let reader = self
            .health
            .iter()
            .find(|reader| reader.process == process)?;
        reader.newest.as_ref()
    }
}
