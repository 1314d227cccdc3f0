//! The children of dead processes. They would keep their parent's sockets, cores and
//! the run's locks.
//!
//! The supervisor is a child subreaper: a process that loses its parent becomes its
//! child, in any session and process group. The mark in its environment
//! ([`crate::set::mark`]) identifies the process of the set from which it descends.

use std::collections::BTreeMap;
use std::fs;

use rustix::process::{
    Pid, PidfdFlags, Signal, WaitId, WaitIdOptions, getpid, pidfd_open, pidfd_send_signal,
    set_child_subreaper, waitid,
};
use shm_config::Instant;

use crate::set::mark::{Mark, Origin, origin};
use crate::set::process_set::ProcessSet;

/// How long orphans are searched for after a death, ns. SIGKILL ends a process within
/// milliseconds unless it waits for a broken disk.
const LOOK_NS: u64 = 2_000_000_000;

/// The orphaned descendants of the set's processes.
#[derive(Debug, Default)]
pub struct Orphans {
    /// When the search began that has not found all of them ended yet.
    since: Option<Instant>,
    killed: BTreeMap<u32, Mark>,
    ended: BTreeMap<String, u64>,
}

impl Orphans {
    /// Makes this process the parent of all processes of the run that lose their parent.
    pub fn adopt() -> Self {
        // Only kernels older than 3.4 refuse it; then orphans do not become children of
        // this process.
        let _ = set_child_subreaper(Some(getpid()));
        Self::default()
    }

    /// Kills and reaps the descendants of dead processes; returns lines for the journal once
    /// they have ended. Never blocks, and costs one system call while no process ends.
    /// Call it after the set was reaped; `died` tells whether a process of it was dead.
    pub fn collect_ended(&mut self, set: &ProcessSet, died: bool, now: Instant) -> Vec<String> {
        if died {
            self.since = Some(now);
        }
        if self.since.is_none() && !has_dead_child() {
            return Vec::new();
        }
        let since = *self.since.get_or_insert(now);
        if self.look(set) && now.since_ns(since) < LOOK_NS {
            return Vec::new();
        }
        self.since = None;
        self.report()
    }

    /// Whether descendants of a dead process are still being ended.
    pub fn remain(&self) -> bool {
        self.since.is_some()
    }

    /// Examines all children once; returns whether more of them may have to be ended.
    fn look(&mut self, set: &ProcessSet) -> bool {
        let members: Vec<u32> = set.members().iter().filter_map(|m| m.pid()).collect();
        let mut is_left = false;
        for (pid, is_dead) in children() {
            // The set reaps its own members.
            if members.contains(&pid) {
                continue;
            }
            if is_dead {
                self.collect(pid);
                continue;
            }
            match origin(pid) {
                Origin::Marked(mark) if !set.carries(&mark) => {
                    is_left = true;
                    self.kill(pid, mark);
                }
                Origin::Unknown => is_left = true,
                Origin::Marked(_) | Origin::Foreign => {}
            }
        }
        // One that is ending has no readable environment any more and looks like a foreign one.
        is_left || !self.killed.is_empty()
    }

    fn kill(&mut self, pid: u32, mark: Mark) {
        // The id is not reused until this process reaps it, so it is the same process.
        let handle = process(pid).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
        let sent = handle.is_some_and(|handle| pidfd_send_signal(handle, Signal::KILL).is_ok());
        if sent {
            self.killed.insert(pid, mark);
        }
    }

    fn collect(&mut self, pid: u32) {
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG;
        if let Some(pid) = process(pid) {
            let _ = waitid(WaitId::Pid(pid), options);
        }
        if let Some(mark) = self.killed.remove(&pid) {
            let word = mark.text().rsplit('.').next().unwrap_or_default();
            *self.ended.entry(word.into()).or_default() += 1;
        }
    }

    fn report(&mut self) -> Vec<String> {
        let ended = std::mem::take(&mut self.ended).into_iter();
        let mut lines: Vec<String> = ended
            .map(|(word, count)| format!("{word}: {} ended", left_over(count)))
            .collect();
        let stuck = std::mem::take(&mut self.killed).len() as u64;
        if stuck > 0 {
            lines.push(format!("{} could not be ended", left_over(stuck)));
        }
        lines
    }
}

fn left_over(count: u64) -> String {
    match count {
        1 => "1 left-over child process".into(),
        count => format!("{count} left-over child processes"),
    }
}

fn process(pid: u32) -> Option<Pid> {
    Pid::from_raw(i32::try_from(pid).ok()?)
}

/// Whether a child has ended and is not reaped yet; leaves it as it is.
fn has_dead_child() -> bool {
    let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
    matches!(waitid(WaitId::All, options), Ok(Some(_)))
}

/// Process ids of all children of this process, and whether each has ended. The
/// kernel's own list of them, `/proc/PID/task/TID/children`, is not in every kernel.
fn children() -> Vec<(u32, bool)> {
    let us = std::process::id();
    let entries = fs::read_dir("/proc").into_iter().flatten().flatten();
    let numbers = entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    numbers
        .filter_map(|pid: u32| {
            let stat = fs::read(format!("/proc/{pid}/stat")).ok()?;
            let (state, parent) = state_and_parent(&stat)?;
            (parent == us).then_some((pid, state == "Z"))
        })
        .collect()
}

/// Parses `/proc/PID/stat`, proc(5). A name may hold any character, also parentheses.
fn state_and_parent(stat: &[u8]) -> Option<(&str, u32)> {
    let name_end = stat.iter().rposition(|byte| *byte == b')')?;
    let rest = str::from_utf8(&stat[name_end + 1..]).ok()?;
    let mut words = rest.split_ascii_whitespace();
    Some((words.next()?, words.next()?.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn state_and_parent_are_read_behind_any_name() {
        let stat = b"71 (a) S 9 (b) Z 4711 71 71 0 -1";
        assert_eq!(state_and_parent(stat), Some(("Z", 4711)));
        assert_eq!(state_and_parent(b"71 (\xff) S 1 "), Some(("S", 1)));
        assert_eq!(state_and_parent(b""), None);
    }
}
