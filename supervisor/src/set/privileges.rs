//! Privileges

use crate::set::table::{Core, ProcessSpec};

/// Cores the supervisor may use before world, planner and controller get one each.
pub const CORES_MIN: usize = 4;
/// Cores it may use before those three share one. They work one after the other, so
/// they lose little by it, and win twice: who is woken on another core waits until that
/// one has noticed, and with two cores either of them can stand still while a chain
/// that runs over both waits for it (results/latency.md).
pub const CORES_SHARED: usize = 2;

/// What a run asks for on one machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Privileges {
    /// Neither priority nor cores: switched off, or lockstep.
    Ordinary,
    /// Priorities, and cores out of these.
    RealTime(Vec<usize>),
}

impl Privileges {
    /// The priority asked for; 0 for none.
    pub fn priority(&self, row: &ProcessSpec) -> u8 {
        match self {
            Self::Ordinary => 0,
            Self::RealTime(_) => row.priority,
        }
    }

    /// The core asked for; `None` for none.
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
}
