//! Real-time privileges: the priority and the core that each process asks for.

use shm_config::config::Config;

use crate::machine::cores::own_cores;
use crate::set::table::{Core, ProcessSpec, TABLE};

/// From this number of usable cores on, world, planner and controller get one each.
pub const CORES_MIN: usize = 4;
/// From this number of usable cores on, those three share one. They work one after the
/// other, so sharing costs little and helps twice: a wake-up on another core waits for an
/// inter-processor interrupt, and on a virtual machine either of two cores may be
/// descheduled while a chain that runs over both waits for it (results/latency.md).
pub const CORES_SHARED: usize = 2;

/// The privileges that a run asks for on one machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Privileges {
    /// Neither priority nor cores: real time is switched off, or the run is in lockstep.
    Ordinary,
    /// Priorities, and cores out of this list.
    RealTime(Vec<usize>),
}

impl Privileges {
    /// The privileges that the processes of a run ask for: none in lockstep, which has no
    /// deadline and would only block the cores for other programs.
    pub fn of(config: &Config) -> Self {
        if !config.supervisor.realtime || config.run.is_lockstep() {
            return Self::Ordinary;
        }
        Self::RealTime(own_cores())
    }

    /// The priority that a process asks for; 0 for none.
    pub fn priority(&self, row: &ProcessSpec) -> u8 {
        match self {
            Self::Ordinary => 0,
            Self::RealTime(_) => row.priority,
        }
    }

    /// The core that a process asks for; `None` for none.
    pub fn core(&self, row: &ProcessSpec) -> Option<usize> {
        match (self, row.core) {
            (Self::RealTime(cores), Core::FromLast(back)) => match cores.len() {
                CORES_MIN.. => cores.iter().rev().nth(back).copied(),
                CORES_SHARED.. => cores.last().copied(),
                _ => None,
            },
            _ => None,
        }
    }

    /// The cores among which a process without priority is to stay; empty for any.
    pub fn cores_left(&self, row: &ProcessSpec) -> Vec<usize> {
        let (Self::RealTime(cores), Core::Left) = (self, row.core) else {
            return Vec::new();
        };
        let taken: Vec<_> = TABLE.iter().filter_map(|row| self.core(row)).collect();
        match taken.is_empty() {
            true => Vec::new(),
            false => cores
                .iter()
                .copied()
                .filter(|core| !taken.contains(core))
                .collect(),
        }
    }
}
