//! The process table: one row for each process of a run.

use shm_config::config::{Config, Keep};
use shm_config::services::Process;

/// What follows the death of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Restart {
    /// It is started again as before.
    Again,
    /// The same; when it died too often, the run goes on without it.
    OrWithout,
    /// It is started again at its episode: `--first-episode K --driven-ns T`; exit 0
    /// ends the run.
    AtEpisode,
}

/// Which core a process asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Core {
    /// None.
    Any,
    /// Those that the others of this table leave, where they leave any: a process that a
    /// tick never waits for keeps its memory out of the caches of the ticks' core.
    Left,
    /// The n-th from the last of the cores that the supervisor may use, in the order of
    /// [`own_cores`](crate::machine::cores::own_cores): the first ones get most of the
    /// machine's interrupts. The last core, on a machine with few.
    FromLast(usize),
}

/// One row of the table.
#[derive(Debug, Clone, Copy)]
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
    /// Whether it is part of a run with this configuration.
    pub is_part_of: fn(&Config) -> bool,
}

fn always(_: &Config) -> bool {
    true
}

/// The process table, in the order of start.
pub const TABLE: &[ProcessSpec] = &[
    ProcessSpec {
        process: Process::Recorder,
        binary: Process::Recorder.binary(),
        core: Core::Left,
        // No tick waits for a disk.
        priority: 0,
        // No process needs it.
        restart: Restart::OrWithout,
        // First, so that it misses no message of the others.
        after: None,
        is_part_of: |config| config.keeps() != Keep::Nothing,
    },
    ProcessSpec {
        process: Process::Planner,
        binary: Process::Planner.binary(),
        core: Core::FromLast(1),
        // Lower than controller and world, which wait for it: a late plan delays one
        // plan, a late command or tick delays the tick.
        priority: 45,
        restart: Restart::Again,
        after: Some(Process::Recorder),
        is_part_of: always,
    },
    ProcessSpec {
        process: Process::Controller,
        binary: Process::Controller.binary(),
        core: Core::FromLast(0),
        // It must answer even while the planner runs.
        priority: 48,
        restart: Restart::Again,
        after: Some(Process::Planner),
        is_part_of: always,
    },
    ProcessSpec {
        process: Process::Gate,
        binary: Process::Gate.binary(),
        core: Core::Any,
        // A slow judge must never delay a tick.
        priority: 0,
        restart: Restart::Again,
        after: Some(Process::Controller),
        is_part_of: |config| config.gate.has_process(),
    },
    ProcessSpec {
        process: Process::Learner,
        binary: Process::Learner.binary(),
        core: Core::Any,
        // It uses only the processor time that the others leave.
        priority: 0,
        restart: Restart::Again,
        after: Some(Process::Gate),
        is_part_of: |config| config.learner.enabled,
    },
    ProcessSpec {
        process: Process::World,
        binary: Process::World.binary(),
        core: Core::FromLast(2),
        // Highest: the world brakes when commands are too old, so a controller in an
        // endless loop must not keep it from a core that they share. The kernel's own
        // interrupt threads have 50.
        priority: 50,
        restart: Restart::AtEpisode,
        after: Some(Process::Learner),
        is_part_of: always,
    },
];

/// The rows that are part of a run with this configuration, in the order of start.
pub fn rows(config: &Config) -> impl Iterator<Item = &'static ProcessSpec> {
    TABLE.iter().filter(|row| (row.is_part_of)(config))
}
