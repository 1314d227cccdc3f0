//! A watcher outside the set: it reads what a vehicle would, and which processes are alive.

use shm_config::Instant;
use shm_config::message::{Command, Driver, Fault, Health, HealthState, Message, Progress, Step};
use shm_config::run::RunName;
use shm_config::services::{self, COMMAND, FAULT, PROGRESS, Process, STEP};
use shm_config::wire::{Publisher, Subscriber, Wire, WireError};

use super::ledger::{Ledger, Limits, is_fresh};
use stack::Clock;

/// The processes that a supervisor starts.
pub const CHILDREN: [Process; 5] = [
    Process::World,
    Process::Planner,
    Process::Controller,
    Process::Gate,
    Process::Learner,
];

/// Commands looked at in one go: a flood must not hold the watcher.
const LOOKED_AT: usize = 16;

/// One process's newest word.
struct Sign {
    process: Process,
    port: Subscriber<Health>,
    newest: Option<Health>,
}

/// What came of one fault so far.
#[derive(Debug, Clone)]
pub struct Trial {
    /// When it struck.
    pub struck: Instant,
    /// When it was over, for what lasts; else when it struck.
    pub over: Option<Instant>,
    /// The last command before it: when it was given.
    pub before: Instant,
    /// An instant of the grid before it.
    pub anchor: Instant,
    /// The controller that dies of it. What it still says before it does moves the
    /// fault's instant: an order to fail is obeyed a moment later.
    pub doomed: Option<u32>,
    /// The first safe command after it: when it was handed over, and whether it is
    /// the brake.
    pub command: Option<(Instant, bool)>,
    /// The first command on inputs that came after it was over.
    pub fresh: Option<Instant>,
}

/// The reading ends, and the account.
pub struct Watch {
    steps: Subscriber<Step>,
    commands: Subscriber<Command>,
    progress: Subscriber<Progress>,
    signs: Vec<Sign>,
    /// The account of everything since the watcher came.
    pub ledger: Ledger,
    /// Fresh steps in a row.
    pub fresh_in_row: u32,
    /// Orders to fail.
    pub orders: Publisher<Fault>,
    trial: Option<Trial>,
    /// The limits of the run.
    pub limits: Limits,
    /// Dropped after the ports.
    pub wire: Wire,
}

impl Watch {
    /// Joins a run that is up, whose supervisor that is.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub fn join(name: &RunName, supervisor: u32, limits: Limits) -> Result<Self, WireError> {
        let wire = Wire::join(name, Process::Learner)?;
        // What the campaign itself forges is not read back.
        wire.follow(supervisor)?;
        wire.await_named(Process::Supervisor, supervisor)?;
        let signs = CHILDREN.map(|process| {
            let port = wire.subscriber(services::health(process))?;
            Ok(Sign {
                process,
                port,
                newest: None,
            })
        });
        Ok(Self {
            steps: wire.subscriber(STEP)?,
            commands: wire.subscriber(COMMAND)?,
            progress: wire.subscriber(PROGRESS)?,
            signs: signs.into_iter().collect::<Result<_, WireError>>()?,
            ledger: Ledger::new(limits, std::process::id()),
            fresh_in_row: 0,
            orders: wire.publisher(FAULT)?,
            trial: None,
            limits,
            wire,
        })
    }

    /// Reads everything that came. Never waits.
    pub fn look(&mut self, clock: Clock) {
        self.steps.update_connections();
        self.commands.update_connections();
        self.progress.update_connections();
        self.orders.update_connections();
        for sign in &mut self.signs {
            sign.port.update_connections();
            // What a dead one left and what its successor says.
            while let Some(health) = sign.port.receive() {
                let newer = sign
                    .newest
                    .is_none_or(|newest| newest.header.taken_ns <= health.header.taken_ns);
                if newer {
                    sign.newest = Some(health);
                }
            }
        }
        while let Some(step) = self.steps.receive() {
            self.take(&step);
        }
        for _ in 0..LOOKED_AT {
            let Some(command) = self.commands.receive() else {
                break;
            };
            // Read after the command came: the watcher itself may be held up.
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
        if given <= trial.struck {
            trial.before = trial.before.max(given);
            return;
        }
        if trial.doomed == Some(step.header.producer) {
            trial.struck = Instant(step.timings.commanded_ns);
            trial.before = given;
            return;
        }
        // A process that was stopped in its tick publishes a command that the vehicle ignores.
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

    /// A fault strikes now. The ports were read just before.
    pub fn begin(&mut self, struck: Instant) {
        let newest = self.ledger.newest();
        self.trial = Some(Trial {
            struck,
            before: newest.map_or(struck, |step| step.command.header.taken()),
            anchor: newest.map_or(struck, |step| Instant(step.timings.scheduled_ns)),
            doomed: None,
            over: None,
            command: None,
            fresh: None,
        });
    }

    /// The controller of this process id dies of the fault.
    pub fn doom(&mut self, pid: Option<i32>) {
        if let Some(trial) = &mut self.trial {
            trial.doomed = pid.and_then(|pid| u32::try_from(pid).ok());
        }
    }

    /// The fault is over, as far as it is up to the campaign.
    pub fn over(&mut self, now: Instant) {
        if let Some(trial) = &mut self.trial {
            trial.over = Some(now);
        }
    }

    /// What came of it so far.
    pub fn trial(&self) -> Option<&Trial> {
        self.trial.as_ref()
    }

    /// Ends the trial.
    pub fn take_trial(&mut self) -> Option<Trial> {
        self.trial.take()
    }

    /// The process id that a process said last.
    pub fn pid(&self, process: Process) -> Option<i32> {
        let health = self.newest(process)?;
        i32::try_from(health.header.producer).ok()
    }

    /// The process was up and spoke after an instant.
    pub fn is_up(&self, process: Process, after: Instant) -> bool {
        self.newest(process).is_some_and(|health| {
            let state = HealthState::from_code(health.state);
            let up = matches!(state, Some(HealthState::Ready | HealthState::Running));
            up && health.header().taken() > after
        })
    }

    fn newest(&self, process: Process) -> Option<&Health> {
        let sign = self.signs.iter().find(|sign| sign.process == process)?;
        sign.newest.as_ref()
    }
}
