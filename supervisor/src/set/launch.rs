//! One child process.

use std::io;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};

use rustix::process::{Pid, Signal};
use shm_config::secret;
use shm_config::services::Process;

use crate::set::log::LogFile;
use crate::set::orphans::{MARK, Mark};
use crate::set::table::{Rights, Row};

/// What children are started with.
#[derive(Debug, Clone)]
pub struct Launch {
    /// Folder of the binaries.
    pub binaries: PathBuf,
    /// The run's resolved configuration.
    pub config: PathBuf,
    /// Priorities and cores.
    pub rights: Rights,
    /// The world when it is not a binary beside the others.
    pub world: Option<Script>,
}

/// Where a restarted world goes on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Resume {
    /// The episode it begins with.
    pub episode: u32,
    /// Time that the run has driven already, ns on the run's clock.
    pub driven_ns: u64,
}

/// A process that an interpreter runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Script {
    /// The interpreter.
    pub interpreter: PathBuf,
    /// What it runs.
    pub file: PathBuf,
}

/// Exit code by which a child says that its configuration or set-up is wrong.
const EXIT_REFUSED: i32 = 2;

/// How a child ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Exit {
    /// Exit code 0.
    Done,
    /// Exit code 2: it would fail again.
    Refused,
    /// Anything else, in words.
    Crashed(String),
}

impl From<ExitStatus> for Exit {
    fn from(status: ExitStatus) -> Self {
        match (status.code(), status.signal()) {
            (Some(0), _) => Self::Done,
            (Some(EXIT_REFUSED), _) => Self::Refused,
            (Some(code), _) => Self::Crashed(format!("exit code {code}")),
            (None, Some(signal)) => {
                Self::Crashed(match signal_hook::low_level::signal_name(signal) {
                    Some(name) => format!("killed by {name}"),
                    None => format!("killed by signal {signal}"),
                })
            }
            (None, None) => Self::Crashed(status.to_string()),
        }
    }
}

impl std::fmt::Display for Exit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Done => f.write_str("exit code 0"),
            Self::Refused => f.write_str("exit code 2"),
            Self::Crashed(how) => f.write_str(how),
        }
    }
}

impl Launch {
    /// Where a row's binary is.
    pub fn binary(&self, row: &Row) -> PathBuf {
        match self.script(row) {
            Some(script) => script.interpreter.clone(),
            None => self.binaries.join(row.binary),
        }
    }

    /// An interpreter runs it.
    pub fn is_script(&self, row: &Row) -> bool {
        self.script(row).is_some()
    }

    fn script(&self, row: &Row) -> Option<&Script> {
        self.world
            .as_ref()
            .filter(|_| row.process == Process::World)
    }

    /// Starts a row. To be called from the main thread only: a child's wish to
    /// die with its parent is bound to the thread that started it.
    ///
    /// # Errors
    /// When the log or the binary cannot be opened.
    pub fn start(&self, row: &Row, log: &mut LogFile, resume: Resume) -> io::Result<Running> {
        let output = log.begin()?;
        let errors = output.try_clone()?;
        let mark = Mark::next(row.process);
        let mut command = Command::new(self.binary(row));
        secret::withhold(&mut command);
        command
            .args(self.script(row).map(|script| &script.file))
            .args(self.arguments(row, resume))
            .env(MARK, mark.text())
            .stdin(match row.process {
                Process::Gate => secret::lend()?,
                _ => Stdio::null(),
            })
            .stdout(output)
            .stderr(errors)
            // Its own group: Ctrl-C in the terminal reaches the supervisor only.
            .process_group(0);
        let child = command.spawn()?;
        Ok(Running { child, mark })
    }

    fn arguments(&self, row: &Row, resume: Resume) -> Vec<String> {
        let mut arguments = vec![
            "--config".into(),
            self.config.display().to_string(),
            "--priority".into(),
            self.rights.priority(row).to_string(),
        ];
        if let Some(core) = self.rights.core(row) {
            arguments.extend(["--core".into(), core.to_string()]);
        }
        if row.restart == crate::set::table::Restart::AtEpisode {
            let numbers = [
                ("--first-episode", u64::from(resume.episode)),
                ("--driven-ns", resume.driven_ns),
            ];
            for (option, number) in numbers.into_iter().filter(|(_, number)| *number > 0) {
                arguments.extend([option.into(), number.to_string()]);
            }
        }
        arguments
    }
}

/// A child that has not been reaped.
#[derive(Debug)]
pub struct Running {
    child: Child,
    mark: Mark,
}

impl Running {
    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// What it and the processes that it starts carry.
    pub fn mark(&self) -> &Mark {
        &self.mark
    }

    /// How it ended; `None` while it has not. Never waits.
    pub fn reap(&mut self) -> Option<Exit> {
        match self.child.try_wait() {
            Ok(status) => status.map(Exit::from),
            // Only when it is not our child any more: then it is gone.
            Err(error) => Some(Exit::Crashed(error.to_string())),
        }
    }

    /// Sends a signal. It cannot hit another process: the id stays taken until
    /// the child is reaped.
    pub fn signal(&self, signal: Signal) {
        // Fails only when it has ended already, which the next look shows.
        let _ = rustix::process::kill_process(Pid::from_child(&self.child), signal);
    }
}

/// The folder of the supervisor's own executable, where its siblings are.
///
/// # Errors
/// When the system does not tell.
pub fn own_folder() -> io::Result<PathBuf> {
    let executable = std::env::current_exe()?;
    match executable.parent() {
        Some(folder) => Ok(folder.into()),
        None => Ok(Path::new("/").into()),
    }
}
