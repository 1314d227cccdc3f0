//! The process table: one row for every process of a run.

use shm_config::config::Config;
use shm_config::services::Process;

/// What follows a death.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Restart {
    /// Started again as before.
    Again,
    /// Started again where it was: `--first-episode K --driven-ns T`; exit 0
    /// ends the run.
    AtEpisode,
}

/// Which core a process asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Core {
    /// None.
    Any,
    /// The n-th from the last of those the supervisor may use, in the order of
    /// [`own_cores`](crate::machine::cores::own_cores): the first ones get most of the
    /// machine's interrupts. The last, where there are few.
    FromLast(usize),
}

/// One row of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProcessSpec {
    /// The process.
    pub process: Process,
    /// Its binary, beside the supervisor's own.
    pub binary: &'static str,
    /// The core it asks for.
    pub core: Core,
    /// The `SCHED_FIFO` priority it asks for; 0 for none.
    pub priority: u8,
    /// What follows its death.
    pub restart: Restart,
    /// It starts when this one, or the nearest before it that is part of the
    /// run, is ready.
    pub after: Option<Process>,
}

/// The process table, in the order of start.
pub const TABLE: &[ProcessSpec] = &[
    ProcessSpec {
        process: Process::Planner,
        binary: "vlaps-planner",
        core: Core::FromLast(1),
        // Below both who wait for it: a late plan costs one tick's plan, a
        // late command or tick costs the tick.
        priority: 45,
        restart: Restart::Again,
        after: None,
    },
    ProcessSpec {
        process: Process::Controller,
        binary: "vlaps-controller",
        core: Core::FromLast(0),
        // It answers whatever the planner does.
        priority: 48,
        restart: Restart::Again,
        after: Some(Process::Planner),
    },
    ProcessSpec {
        process: Process::Gate,
        binary: "vlaps-gate",
        core: Core::Any,
        // A slow judge must never delay a tick.
        priority: 0,
        restart: Restart::Again,
        after: Some(Process::Controller),
    },
    ProcessSpec {
        process: Process::Learner,
        binary: "vlaps-learner",
        core: Core::Any,
        // It takes what the others leave.
        priority: 0,
        restart: Restart::Again,
        after: Some(Process::Gate),
    },
    ProcessSpec {
        process: Process::World,
        binary: "vlaps-world",
        core: Core::FromLast(2),
        // Highest: it brakes when commands are too old, so that a controller which
        // spins must not keep it from a core they share. 50 is where the kernel puts
        // its own interrupt threads.
        priority: 50,
        restart: Restart::AtEpisode,
        after: Some(Process::Learner),
    },
];

/// The rows that are part of a run.
pub fn rows(config: &Config) -> impl Iterator<Item = &'static ProcessSpec> {
    let (gate, learner) = (config.gate.has_process(), config.learner.enabled);
    TABLE.iter().filter(move |row| match row.process {
        Process::Gate => gate,
        Process::Learner => learner,
        Process::Supervisor | Process::World | Process::Planner | Process::Controller => true,
    })
}
