//! Foreign processes: they send in the place of a process of the run, which has not
//! started them.

use std::fs;
use std::path::Path;

use shm_config::run::RunPaths;
use shm_config::text::printable;
use shm_config::wire::{Foreigner, Wire};

use crate::run::shared_memory::SHARED_MEMORY_DIR;
use crate::telemetry::process_tally::ProcessTally;
use crate::telemetry::tally::Tally;

/// The most foreign processes that are reported by name.
const NAMED_MAX: usize = 16;

/// The foreign processes that were reported.
#[derive(Debug, Default)]
pub struct ForeignReports {
    named: Vec<Foreigner>,
}

impl ForeignReports {
    /// Warnings about foreign processes that were not reported yet.
    pub fn take_new(&mut self, wire: &Wire, tally: &Tally, paths: &RunPaths) -> Vec<String> {
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
