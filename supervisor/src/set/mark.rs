//! The mark of a start of a process, which its descendants inherit in their environment.
//! It tells the descendants of dead processes from those of living ones, and from processes
//! that do not belong to the run, such as a child that a shell started before it executed
//! the supervisor.

use std::fs::File;
use std::io::Read as _;
use std::sync::atomic::{AtomicU64, Ordering};

use shm_config::services::Process;

/// The environment variable that holds the mark.
pub const MARK: &str = "VLAPS_CHILD_OF";

/// Longest environment that is read, bytes: the kernel admits 2 MiB of arguments and
/// environment by default.
const ENVIRONMENT_BYTES_MAX: u64 = 2 << 20;

/// Names the process, and the start of it, that a process descends from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mark(String);

impl Mark {
    /// The mark of the next start of a process by this supervisor.
    pub fn next(process: Process) -> Self {
        static STARTS: AtomicU64 = AtomicU64::new(0);
        let start = STARTS.fetch_add(1, Ordering::Relaxed);
        Self(format!("{}{start}.{}", Self::of_ours(), process.word()))
    }

    /// The prefix of all marks of this supervisor.
    fn of_ours() -> String {
        format!("{}.", std::process::id())
    }

    /// The mark as the environment holds it.
    pub fn text(&self) -> &str {
        &self.0
    }
}

/// Where a child of the supervisor comes from.
pub(crate) enum Origin {
    /// It descends from the start with this mark.
    Marked(Mark),
    /// It carries no mark of this supervisor.
    Foreign,
    /// Not known yet, because it is executing another program at this moment.
    Unknown,
}

pub(crate) fn origin(pid: u32) -> Origin {
    let mut environment = Vec::new();
    let read = File::open(format!("/proc/{pid}/environ")).and_then(|file| {
        file.take(ENVIRONMENT_BYTES_MAX)
            .read_to_end(&mut environment)
    });
    match read {
        // Empty during an exec, and of a process that has just ended.
        Ok(0) => return Origin::Unknown,
        Ok(_) => {}
        Err(_) => return Origin::Foreign,
    }
    match mark_in(&environment) {
        Some(mark) => Origin::Marked(mark),
        None => Origin::Foreign,
    }
}

/// The mark of this supervisor in an environment block.
fn mark_in(environment: &[u8]) -> Option<Mark> {
    let marks = environment.split(|byte| *byte == 0).filter_map(|entry| {
        let (name, value) = str::from_utf8(entry).ok()?.split_once('=')?;
        (name == MARK).then_some(value)
    });
    let mut ours = marks.filter(|value| value.starts_with(&Mark::of_ours()));
    ours.next().map(|value| Mark(value.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_is_found_among_other_variables_and_no_other_is_ours() {
        let mark = Mark::next(Process::World);
        assert_ne!(mark, Mark::next(Process::World), "each start has its own");
        let text = format!("PATH=/bin\0{MARK}={}\0B=1", mark.text());
        assert_eq!(mark_in(text.as_bytes()), Some(mark));
        // A supervisor that a process of this set has started has other marks.
        let other = format!("{MARK}=1{}0.world\0", Mark::of_ours());
        assert_eq!(mark_in(other.as_bytes()), None);
        assert_eq!(mark_in(b"PATH=/bin\0X=VLAPS_CHILD_OF=1\0"), None);
    }
}
