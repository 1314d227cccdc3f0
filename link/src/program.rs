//! The program of the build that runs on the mirrored services.

use std::fs::File;
use std::io;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use shm_config::Instant;
use shm_config::secret;
use shm_config::services::Process;

/// Pause before the first restart, ns; it doubles.
const PAUSE_NS: u64 = 500_000_000;
/// Restarts until the join is given up.
const RESTARTS_MAX: u32 = 8;
/// Looks for the end of a program that was asked to end, one every 20 ms: 5 s.
const END_LOOKS: u32 = 250;

/// A program, started again when it ends.
pub struct Program {
    process: Process,
    path: PathBuf,
    config: PathBuf,
    log: PathBuf,
    child: Option<Child>,
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
    /// The build's program of a process, not started yet.
    ///
    /// # Errors
    /// When the folder of this program is not known.
    pub fn new(process: Process, config: &Path, log: PathBuf) -> io::Result<Self> {
        let own = std::env::current_exe()?;
        let folder = own.parent().unwrap_or(Path::new("/"));
        Ok(Self {
            process,
            path: folder.join(process.binary()),
            config: config.into(),
            log,
            child: None,
            due: Instant(0),
            ends: 0,
        })
    }

    fn start(&self) -> io::Result<Child> {
        let log = File::options().create(true).append(true).open(&self.log)?;
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
        let log = self.log.display();
        let text = shm_config::file::read_text(&self.log, 1 << 20).unwrap_or_default();
        let line = text.lines().rev().find(|line| !line.trim().is_empty());
        format!("{} ({log})", line.unwrap_or("it wrote nothing"))
    }

    /// Ends it: asked first, killed when it does not.
    pub fn end(&mut self) {
        let Some(mut child) = self.child.take() else {
            return;
        };
        // It fails only when it has ended already.
        let _ = kill_process(Pid::from_child(&child), Signal::TERM);
        for _ in 0..END_LOOKS {
            if !matches!(child.try_wait(), Ok(None)) {
                return;
            }
            std::thread::park_timeout(Duration::from_millis(20));
        }
        let _ = child.kill();
        let _ = child.wait();
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        self.end();
    }
}
