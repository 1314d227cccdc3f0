//! The roster of a run: the processes that the run has started.

use shm_config::message::Roster;
use shm_config::services::{Process, ROSTER};
use shm_config::wire::{Wire, WireError};

use crate::set::process_set::ProcessSet;

shm_config::ports! {
    /// Where the roster goes.
    pub struct RosterPorts of Supervisor {
        /// To every process of the run.
        roster: write ROSTER: Roster,
    }
}

/// Publishes the process ids that the run has started.
pub struct RosterPublisher {
    roster: Roster,
    ports: RosterPorts,
}

impl RosterPublisher {
    /// Publishes a roster with the supervisor alone. From now on this membership accepts
    /// state only from processes on the roster.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub fn open(wire: &Wire) -> Result<Self, WireError> {
        let mut roster = Roster::default();
        roster.set(Process::Supervisor, Some(std::process::id()));
        let mut ports = RosterPorts::open(wire)?;
        ports.roster.send(&mut roster);
        wire.trust(&roster);
        Ok(Self { roster, ports })
    }

    /// Puts a process of the run on the roster, and publishes the roster when it changes. A
    /// dead process stays on it until its successor replaces it, so that its last messages
    /// are accepted.
    pub fn name(&mut self, wire: &Wire, process: Process, pid: u32) {
        if self.roster.pid(process) != Some(pid) {
            self.roster.set(process, Some(pid));
            self.ports.roster.send(&mut self.roster);
            wire.trust(&self.roster);
        }
    }

    /// Puts the living processes of a set on the roster, and delivers it to new subscribers.
    pub fn publish(&mut self, wire: &Wire, set: &ProcessSet) {
        for member in set.members() {
            if let Some(pid) = member.pid() {
                self.name(wire, member.row().process, pid);
            }
        }
        self.update_connections();
    }

    /// Delivers the roster to new subscribers.
    pub fn update_connections(&mut self) {
        self.ports.update_connections();
    }
}
