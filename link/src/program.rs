//! The program of the build that runs on the mirrored services.

use std::io;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use runtime::LogFile;
use rustix::process::{Pid, Signal, kill_process};
use shm_config::Instant;
use shm_config::secret;
use shm_config::services::Process;

/// Pause before the first restart, ns; it doubles.
const PAUSE_NS: u64 = 500_000_000;
/// Restarts until the join is given up.
const RESTARTS_MAX: u32 = 8;
/// A program that was asked to end has this long until it is killed, ns.
const END_NS: u64 = 5_000_000_000;
/// Time between two looks for its end.
const END_LOOK: Duration = Duration::from_millis(20);

/// A program, started again when it ends.
pub struct Program {
    process: Process,
    path: PathBuf,
    config: PathBuf,
    log: LogFile,
    child: Option<Child>,
    /// When it was asked to end.
    asked: Option<Instant>,
    due: Instant,
    /// Times that it has ended.
    pub ends: u32,
}

/// What a look at it has shown.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Look {
    /// It runs, or waits for its restart.
    Same,
    /// It was started under this process id.
    Started(u32),
    /// It cannot be started, or ends each time.
    GivenUp(String),
}

impl Program {
    /// The build's program of a process, not started yet, with its log in a folder; a log
    /// longer than so many bytes is set aside.
    ///
    /// # Errors
    /// When the folder of this program is not known, or the log cannot be made.
    pub fn new(
        process: Process,
        config: &Path,
        (logs, limit_bytes): (PathBuf, u64),
    ) -> io::Result<Self> {
        let own = std::env::current_exe()?;
        let folder = own.parent().unwrap_or(Path::new("/"));
        Ok(Self {
            process,
            path: folder.join(process.binary()),
            config: config.into(),
            log: LogFile::create(&logs, process.word(), limit_bytes)?,
            child: None,
            asked: None,
            due: Instant(0),
            ends: 0,
        })
    }

    fn start(&mut self) -> io::Result<Child> {
        let log = self.log.begin()?;
        let mut command = Command::new(&self.path);
        secret::withhold(&mut command);
        command
            .arg("--config")
            .arg(&self.config)
            .args(["--priority", "0"])
            .stdin(match self.process {
                Process::Gate => secret::lend()?,
                _ => Stdio::null(),
            })
            .stdout(log.try_clone()?)
            .stderr(log)
            .process_group(0);
        command.spawn()
    }

    /// Starts it when it is due. Call it from the main thread only: its parent-death signal
    /// is bound to the thread that started it.
    pub fn look(&mut self, now: Instant) -> Look {
        if let Some(child) = &mut self.child {
            let Ok(Some(status)) = child.try_wait() else {
                // A full disk costs older lines, and nothing else.
                let _ = self.log.rotate();
                return Look::Same;
            };
            self.child = None;
            self.ends += 1;
            self.due = now.after_ns(PAUSE_NS << self.ends.min(6));
            let name = self.process.binary();
            tracing::warn!(%status, "{name} has ended");
            // Two: it could not be set up, and would fail again.
            if status.code() == Some(2) || self.ends > RESTARTS_MAX {
                return Look::GivenUp(format!("{name} has ended, {status}: {}", self.last_line()));
            }
        }
        if now < self.due {
            return Look::Same;
        }
        match self.start() {
            Ok(child) => {
                let pid = child.id();
                self.child = Some(child);
                Look::Started(pid)
            }
            Err(error) => Look::GivenUp(format!("{}: {error}", self.path.display())),
        }
    }

    /// Whether it runs.
    pub fn is_running(&self) -> bool {
        self.child.is_some()
    }

    fn last_line(&self) -> String {
        let log = self.log.path().display();
        let line = self.log.last_line();
        format!("{} ({log})", line.as_deref().unwrap_or("it wrote nothing"))
    }

    /// Asks it to end, kills it when it does not, and waits for neither; whether it has
    /// ended.
    pub fn has_ended(&mut self, now: Instant) -> bool {
        let Some(child) = &mut self.child else {
            return true;
        };
        if !matches!(child.try_wait(), Ok(None)) {
            self.child = None;
            return true;
        }
        // Both fail only when it has ended already.
        match self.asked {
            None => {
                self.asked = Some(now);
                let _ = kill_process(Pid::from_child(child), Signal::TERM);
            }
            Some(asked) if now.since_ns(asked) > END_NS => drop(child.kill()),
            Some(_) => {}
        }
        false
    }

    /// Ends it and waits for that.
    pub fn end(&mut self) {
        let mut waited_ns = 0;
        self.asked = None;
        while !self.has_ended(Instant(waited_ns)) {
            std::thread::park_timeout(END_LOOK);
            waited_ns += END_LOOK.as_nanos() as u64;
        }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        self.end();
    }
}
