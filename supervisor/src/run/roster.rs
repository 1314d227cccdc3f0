//! The roster of a run, and foreign processes, which send although they are not on it.

use std::fs;
use std::path::Path;

use shm_config::message::Roster;
use shm_config::run::RunPaths;
use shm_config::services::{Process, ROSTER};
use shm_config::text::printable;
use shm_config::wire::{Foreigner, Publisher, Wire, WireError};

use crate::run::shared_memory::SHARED_MEMORY_DIR;
use crate::set::process_set::ProcessSet;
use crate::telemetry::process_tally::ProcessTally;
use crate::telemetry::tally::Tally;

/// The most foreign processes that are reported by name.
const NAMED_MAX: usize = 16;

/// Publishes the process ids that the run has started, and remembers which foreign
/// processes were reported.
pub struct RosterPublisher {
    roster: Roster,
    port: Publisher<Roster>,
    named: Vec<Foreigner>,
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
        let mut port = wire.publisher(ROSTER)?;
        port.send(&mut roster);
        wire.trust(&roster);
        Ok(Self {
            roster,
            port,
            named: Vec::new(),
        })
    }

    /// Puts a process of the run on the roster, and publishes the roster when it changes. A
    /// dead process stays on it until its successor replaces it, so that its last messages
    /// are accepted.
    pub fn name(&mut self, wire: &Wire, process: Process, pid: u32) {
        if self.roster.pid(process) != Some(pid) {
            self.roster.set(process, Some(pid));
            self.port.send(&mut self.roster);
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
        self.port.update_connections();
    }

    /// Warnings about foreign processes that were not reported yet.
    pub fn foreigners(&mut self, wire: &Wire, tally: &Tally, paths: &RunPaths) -> Vec<String> {
        let mut lines = Vec::new();
        for foreigner in tally.foreigners().chain(wire.foreigner()) {
            if self.named.contains(&foreigner) || self.named.len() >= NAMED_MAX {
                continue;
            }
            self.named.push(foreigner);
            lines.push(warning(foreigner, tally, paths));
        }
        lines
    }
}

/// The warning about a foreign process.
pub fn warning(foreigner: Foreigner, tally: &Tally, paths: &RunPaths) -> String {
    let Foreigner { pid, place } = foreigner;
    let named = tally.process(place).and_then(ProcessTally::newest);
    let is_own = named.is_some_and(|health| health.header.producer == pid);
    format!(
        "warning: process {pid} ({}) sends in the place of the {place}, and this run did not \
         start it: its messages are refused, and the car is braked where they could be taken \
         for the run's own; end it",
        match is_own {
            true => OTHER_NAMESPACE.into(),
            false => program(pid, paths),
        }
    )
}

/// A process id means another process in each pid namespace, such as in a container.
const OTHER_NAMESPACE: &str = "a process of another pid namespace";

/// The program of a process, as the kernel names it. The number is that of a process of
/// this namespace when that one is a member of the run.
fn program(pid: u32, paths: &RunPaths) -> String {
    let Ok(name) = fs::read_to_string(format!("/proc/{pid}/comm")) else {
        return format!("it has ended, or is {OTHER_NAMESPACE}");
    };
    match is_member(pid, paths) {
        // A process may choose its name: it is untrusted text.
        true => printable(name.trim()).into_owned(),
        false => format!("it has left the run, or is {OTHER_NAMESPACE}"),
    }
}

/// A process has one of the run's files of shared memory in its memory.
fn is_member(pid: u32, paths: &RunPaths) -> bool {
    let prefix = Path::new(SHARED_MEMORY_DIR).join(paths.prefix());
    let maps = fs::read(format!("/proc/{pid}/maps")).unwrap_or_default();
    let prefix = prefix.as_os_str().as_encoded_bytes();
    maps.windows(prefix.len()).any(|part| part == prefix)
}
