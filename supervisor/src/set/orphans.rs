//! What a dead process leaves behind: its children. They would hold its sockets,
//! cores and the run's locks, and go on unseen.
//!
//! The supervisor is their subreaper: whoever loses its parent becomes its child,
//! whatever session or process group it has moved to. Each process of the set
//! carries a mark in its environment, which its children inherit; so those of the
//! dead are told from those of the living, and from processes that are nothing of
//! the run, such as what a shell started before it became the supervisor.

use std::collections::BTreeMap;
use std::fs;

use rustix::process::{
    Pid, PidfdFlags, Signal, WaitId, WaitIdOptions, getpid, pidfd_open, pidfd_send_signal,
    set_child_subreaper, waitid,
};
use shm_config::Instant;

use crate::set::mark::{Mark, Origin, origin};
use crate::set::process_set::ProcessSet;

/// How long left-over processes are looked for after a death, ns. SIGKILL ends a
/// process within milliseconds unless it waits for a broken disk.
const LOOK_NS: u64 = 2_000_000_000;

/// The left-over children of the set's processes.
#[derive(Debug, Default)]
pub struct Orphans {
    /// When a look began that has not found all gone yet.
    since: Option<Instant>,
    killed: BTreeMap<u32, Mark>,
    ended: BTreeMap<String, u64>,
}

impl Orphans {
    /// Makes this process the parent of all processes of the run that lose theirs.
    pub fn adopt() -> Self {
        // Refused only by kernels older than 3.4: then nothing is left over to us.
        let _ = set_child_subreaper(Some(getpid()));
        Self::default()
    }

    /// Kills and collects the children of dead processes; what there is to tell, once
    /// they are gone. Never waits. While nothing ends it costs one system call.
    /// The set has been reaped, and `died` says whether one of it was found dead.
    pub fn collect_ended(&mut self, set: &ProcessSet, died: bool, now: Instant) -> Vec<String> {
        if died {
            self.since = Some(now);
        }
        if self.since.is_none() && !has_dead_child() {
            return Vec::new();
        }
        let is_left = self.look(set);
        match self.since {
            Some(since) if is_left && now.since_ns(since) < LOOK_NS => return Vec::new(),
            _ => self.since = None,
        }
        self.report()
    }

    /// A dead process's children are still being ended.
    pub fn remain(&self) -> bool {
        self.since.is_some()
    }

    /// One look at all children; whether there may be more to end.
    fn look(&mut self, set: &ProcessSet) -> bool {
        let members: Vec<u32> = set.members().iter().filter_map(|m| m.pid()).collect();
        let mut is_left = false;
        for (pid, is_dead) in children() {
            // A member that has ended meanwhile is the set's to collect.
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
        is_left
    }

    fn kill(&mut self, pid: u32, mark: Mark) {
        // The number stays taken until we collect it, so it is still who it was.
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

/// Some child has ended and is not collected; it is left as it is.
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

/// From `/proc/PID/stat`, proc(5). A name may hold anything, parentheses too.
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
