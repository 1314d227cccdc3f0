//! The process that holds a run's supervisor file.
//!
//! The kernel's list of locks names the process that took a lock, even when that
//! process has ended and another one has inherited its descriptor, and the id may
//! belong to another program by now. So the result is only shown to the user; before it
//! gets a signal, the process must prove to be the run's supervisor.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::{FileExt, MetadataExt};

/// The longest record that is read back, bytes: two numbers of twenty digits.
const RECORD_BYTES_MAX: usize = 64;

/// The process that holds a run's supervisor file, as kernel and file report it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Holder {
    /// Its process id.
    pub pid: u32,
    /// When the supervisor that wrote this process id was started, in clock ticks since
    /// the machine started; `None` when the file does not contain it.
    pub started: Option<u64>,
    /// Device and inode of the file, by which an open descriptor is recognised.
    pub file: (u64, u64),
}

impl Holder {
    /// The holder of a file that is locked by another process; `None` when neither the
    /// kernel nor the file names one.
    pub(super) fn of(file: &File) -> Option<Self> {
        let metadata = file.metadata().ok()?;
        let mut bytes = [0; RECORD_BYTES_MAX];
        let length = file.read_at(&mut bytes, 0).ok()?;
        let recorded = recorded(bytes.get(..length)?);
        // The file may have been overwritten, so the kernel comes first. Where the
        // kernel names no process, because it is of another container, the file does.
        let locks = fs::read_to_string("/proc/locks").unwrap_or_default();
        let pid = holder(&locks, &metadata).or(recorded.map(|(pid, _)| pid))?;
        Some(Self {
            pid,
            started: recorded
                .filter(|(of, _)| *of == pid)
                .and_then(|(_, started)| started),
            file: (metadata.dev(), metadata.ino()),
        })
    }

    /// Whether a record is of this process. Its start tells it from an earlier process of
    /// the same id, unless the supervisor's file was overwritten.
    pub(super) fn is_named_in(&self, record: &[u8]) -> bool {
        recorded(record).is_some_and(|(pid, started)| {
            pid == self.pid && (self.started.is_none() || self.started == started)
        })
    }
}

/// The calling process's id and start, as the run's files name it.
pub(super) fn own_record() -> String {
    let pid = std::process::id();
    match started(pid) {
        Some(started) => format!("{pid} {started}\n"),
        None => format!("{pid}\n"),
    }
}

/// Writes the calling process's id and start to a file that it has locked.
pub(super) fn record(file: &File) -> io::Result<()> {
    file.set_len(0)?;
    file.write_all_at(own_record().as_bytes(), 0)
}

/// When a process was started, in clock ticks since the machine started; `None` if no
/// process has this id.
pub fn started(pid: u32) -> Option<u64> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The program's name is in parentheses and may contain any character.
    let (_, fields) = stat.rsplit_once(')')?;
    fields.split_whitespace().nth(19)?.parse().ok()
}

fn recorded(bytes: &[u8]) -> Option<(u32, Option<u64>)> {
    let mut words = std::str::from_utf8(bytes).ok()?.split_whitespace();
    let pid = words.next()?.parse().ok()?;
    Some((pid, words.next().and_then(|word| word.parse().ok())))
}

/// The process that took the lock on a file, out of the kernel's list:
/// `1: FLOCK  ADVISORY  WRITE 4711 00:1b:5678 0 EOF`.
fn holder(locks: &str, metadata: &fs::Metadata) -> Option<u32> {
    let device = metadata.dev();
    let (major, minor) = (rustix::fs::major(device), rustix::fs::minor(device));
    let place = format!("{major:02x}:{minor:02x}:{}", metadata.ino());
    locks.lines().find_map(|line| {
        let words: Vec<_> = line.split_whitespace().collect();
        match words.as_slice() {
            [_, "FLOCK", _, "WRITE", pid, at, ..] if *at == place => {
                pid.parse().ok().filter(|pid| *pid > 0)
            }
            _ => None,
        }
    })
}
