//! The roster of a run, and the processes that send although they are not on it.

use std::fs;

use shm_config::message::Roster;
use shm_config::services::{Process, ROSTER};
use shm_config::text::printable;
use shm_config::wire::{Foreigner, Publisher, Wire, WireError};

use crate::set::process_set::ProcessSet;

/// Foreign processes that are named; of more the count says enough.
const NAMED_MAX: usize = 16;

/// Publishes which processes the run has started, and remembers which others were told
/// of.
pub struct RosterPublisher {
    roster: Roster,
    port: Publisher<Roster>,
    named: Vec<Foreigner>,
}

impl RosterPublisher {
    /// Names the supervisor alone. From now on this membership takes state only from
    /// those that are named.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub fn open(wire: &Wire) -> Result<Self, WireError> {
        let mut roster = Roster::default();
        roster.set(Process::Supervisor, Some(std::process::id()));
        let mut port = wire.publisher(ROSTER)?;
        port.send(&mut roster);
        wire.trust(&roster);
        Ok(Self {
            roster,
            port,
            named: Vec::new(),
        })
    }

    /// Names a process of the run; publishes the roster when it changes. A dead one
    /// stays named until its successor is: what it left is its own.
    pub fn name(&mut self, wire: &Wire, process: Process, pid: u32) {
        if self.roster.pid(process) != Some(pid) {
            self.roster.set(process, Some(pid));
            self.port.send(&mut self.roster);
            wire.trust(&self.roster);
        }
    }

    /// Names the living processes of a set, and passes the roster on to readers that
    /// came meanwhile.
    pub fn publish(&mut self, wire: &Wire, set: &ProcessSet) {
        for member in set.members() {
            if let Some(pid) = member.pid() {
                self.name(wire, member.row().process, pid);
            }
        }
        self.update_connections();
    }

    /// Passes the roster on to readers that came meanwhile.
    pub fn update_connections(&mut self) {
        self.port.tend();
    }

    /// What to say of the processes that send in the place of others and were not told
    /// of yet.
    pub fn foreigners(
        &mut self,
        wire: &Wire,
        heard: impl Iterator<Item = Foreigner>,
    ) -> Vec<String> {
        let mut lines = Vec::new();
        for foreigner in heard.chain(wire.foreigner()) {
            if self.named.contains(&foreigner) || self.named.len() >= NAMED_MAX {
                continue;
            }
            self.named.push(foreigner);
            lines.push(warning(foreigner));
        }
        lines
    }
}

/// What to say of a process that sends in the place of another.
pub fn warning(foreigner: Foreigner) -> String {
    let Foreigner { pid, place } = foreigner;
    format!(
        "warning: process {pid} ({}) sends in the place of the {place}, and this run did not \
         start it: its messages are refused, and the car is braked where they could be taken \
         for the run's own; end it",
        program(pid)
    )
}

/// What a process runs, as far as the kernel tells.
fn program(pid: u32) -> String {
    let name = fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
    // A process names itself as it likes.
    let name = printable(name.trim());
    match name.is_empty() {
        true => "it has ended".into(),
        false => name.into_owned(),
    }
}
