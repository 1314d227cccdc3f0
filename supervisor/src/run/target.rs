//! The supervisor of a run, as the target of a signal.
//!
//! The kernel reuses process ids, and the process that locked a run's file may have ended
//! while another one, which inherited its descriptor, keeps the lock. So the process is
//! held by a pidfd first and then checked; if it ends meanwhile, the signal reaches no
//! process.

use std::fs;
use std::os::fd::OwnedFd;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use rustix::io::Errno;
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};
use shm_config::file::user;
use shm_config::run::{Holder, RunPaths, started};

use crate::cli::failure::Failure;

/// Prefix of the program's name. The kernel appends a note when the file was rebuilt
/// meanwhile.
const PROGRAM: &str = "vlaps-supervisor";

/// A run's supervisor, held by a pidfd.
#[derive(Debug)]
pub struct Target {
    pid: u32,
    handle: OwnedFd,
}

impl Target {
    /// The supervisor of a run; `None` when no process holds the run.
    ///
    /// # Errors
    /// When the run's files belong to another user, or the process that holds the run is
    /// no supervisor of it.
    pub fn of(paths: &RunPaths) -> Result<Option<Self>, Failure> {
        let Some(holder) = paths.holder()? else {
            return Ok(None);
        };
        match Self::verify(&holder) {
            Ok(target) => Ok(Some(target)),
            // It may have ended since.
            Err(_) if paths.holder()?.is_none() => Ok(None),
            Err(why) => Err(Failure::GivenUp(format!(
                "run '{name}': process {pid} is not its supervisor ({why}); it gets no signal; \
                 `fuser {file}` shows the process that holds the run",
                name = paths.name(),
                pid = holder.pid,
                file = paths.supervisor_file().display()
            ))),
        }
    }

    /// All checks after `pidfd_open` concern the process that the handle holds.
    fn verify(holder: &Holder) -> Result<Self, String> {
        let pid = holder.pid;
        let id = i32::try_from(pid).ok().and_then(Pid::from_raw);
        let id = id.ok_or("it is not a process id")?;
        let handle = pidfd_open(id, PidfdFlags::empty()).map_err(|error| error.to_string())?;
        let proc = format!("/proc/{pid}");
        let owner = fs::metadata(&proc).map_err(|error| error.to_string())?;
        if owner.uid() != user() {
            return Err(format!("it belongs to user {}", owner.uid()));
        }
        let program = fs::read_link(format!("{proc}/exe")).map_err(|error| error.to_string())?;
        if !is_supervisor(&program) {
            return Err(format!("it runs {}", program.display()));
        }
        let is_same = |begun| started(pid) == Some(begun);
        if !holder.started.is_none_or(is_same) {
            return Err("it was started after the supervisor".into());
        }
        if !has_open(&proc, holder.file) {
            return Err("it is the supervisor of another run".into());
        }
        Ok(Self { pid, handle })
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.pid
    }

    /// Sends it a signal; if it has ended, no other process gets it.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn signal(&self, signal: Signal) -> Result<(), Errno> {
        match pidfd_send_signal(&self.handle, signal) {
            Err(Errno::SRCH) => Ok(()),
            sent => sent,
        }
    }
}

fn is_supervisor(program: &Path) -> bool {
    let name = program.file_name();
    name.is_some_and(|name| name.to_string_lossy().starts_with(PROGRAM))
}

/// Whether the process has this file open, by device and inode.
fn has_open(proc: &str, file: (u64, u64)) -> bool {
    let entries = fs::read_dir(format!("{proc}/fd"));
    entries.into_iter().flatten().flatten().any(|entry| {
        // The metadata of the link's target, without opening it.
        fs::metadata(entry.path()).is_ok_and(|found| (found.dev(), found.ino()) == file)
    })
}
