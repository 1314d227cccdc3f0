//! The start of one child process.

use std::io;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use runtime::LogFile;
use rustix::process::{Pid, Signal};
use shm_config::secret;
use shm_config::services::Process;

use crate::machine::programs::Executable;
use crate::set::exit::Exit;
use crate::set::mark::{MARK, Mark};
use crate::set::privileges::Privileges;
use crate::set::table::ProcessSpec;

/// What all children are started with.
#[derive(Debug, Clone)]
pub struct Launch {
    /// Folder of the binaries.
    pub binaries: PathBuf,
    /// The run's resolved configuration.
    pub config: PathBuf,
    /// Priorities and cores that they ask for.
    pub privileges: Privileges,
    /// Those that run in place of programs of the build.
    pub programs: Vec<Program>,
}

/// Where a restarted world continues.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Resume {
    /// The first episode that it drives.
    pub episode: u32,
    /// Time driven by the run so far, ns on the run's clock.
    pub driven_ns: u64,
}

/// A program in place of one of the build; it takes the same arguments.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Program {
    /// The process that it is.
    pub process: Process,
    /// The executable file.
    pub path: PathBuf,
    /// The file that it runs, when it is an interpreter.
    pub script: Option<PathBuf>,
}

/// Whose program a process runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// One of the build.
    OfTheBuild,
    /// A script of the repository, which an interpreter runs.
    Script,
    /// The user's.
    OfTheUser,
}

impl Launch {
    /// The binary of a row.
    pub fn binary(&self, row: &ProcessSpec) -> PathBuf {
        match self.program(row) {
            Some(program) => program.path.clone(),
            None => self.binaries.join(row.binary),
        }
    }

    /// Whose program a row runs.
    pub fn kind(&self, row: &ProcessSpec) -> Kind {
        match self.program(row) {
            None => Kind::OfTheBuild,
            Some(program) => match program.script {
                Some(_) => Kind::Script,
                None => Kind::OfTheUser,
            },
        }
    }

    fn program(&self, row: &ProcessSpec) -> Option<&Program> {
        let mut programs = self.programs.iter();
        programs.find(|program| program.process == row.process)
    }

    /// Starts a row. Call it from the main thread only: the parent-death signal of a child
    /// is bound to the thread that started it.
    ///
    /// # Errors
    /// When the log or the binary cannot be opened.
    pub fn start(
        &self,
        row: &ProcessSpec,
        executable: &Executable,
        log: &mut LogFile,
        resume: Resume,
    ) -> io::Result<Running> {
        let output = log.begin()?;
        let errors = output.try_clone()?;
        let mark = Mark::next(row.process);
        let mut command = Command::new(executable.path());
        secret::withhold(&mut command);
        command
            .args(
                self.program(row)
                    .and_then(|program| program.script.as_ref()),
            )
            .args(self.arguments(row, resume))
            .env(MARK, mark.text())
            .stdin(match row.process {
                // The key of the model is for the gate of the build alone.
                Process::Gate if self.kind(row) == Kind::OfTheBuild => secret::lend()?,
                _ => Stdio::null(),
            })
            .stdout(output)
            .stderr(errors)
            // Its own process group: Ctrl-C in the terminal reaches the supervisor only.
            .process_group(0);
        let child = command.spawn()?;
        Ok(Running { child, mark })
    }

    fn arguments(&self, row: &ProcessSpec, resume: Resume) -> Vec<String> {
        let mut arguments = vec![
            "--config".into(),
            self.config.display().to_string(),
            "--priority".into(),
            self.privileges.priority(row).to_string(),
        ];
        if let Some(core) = self.privileges.core(row) {
            arguments.extend(["--core".into(), core.to_string()]);
        }
        // A user's program knows no such option.
        if self.kind(row) == Kind::OfTheBuild {
            let cores = self.privileges.cores_left(row).into_iter();
            arguments.extend(cores.flat_map(|core| ["--among".into(), core.to_string()]));
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

    /// The mark that it and its descendants carry.
    pub fn mark(&self) -> &Mark {
        &self.mark
    }

    /// How it ended; `None` while it runs. Never blocks.
    pub fn reap(&mut self) -> Option<Exit> {
        match self.child.try_wait() {
            Ok(status) => status.map(Exit::from),
            // The wait fails only for a process that is not a child any more, so it has
            // ended.
            Err(error) => Some(Exit::Crashed(error.to_string())),
        }
    }

    /// Sends a signal. It cannot reach another process: the kernel does not reuse the id
    /// until the child is reaped.
    pub fn signal(&self, signal: Signal) {
        // Fails only when it has ended already, which the next reap shows.
        let _ = rustix::process::kill_process(Pid::from_child(&self.child), signal);
    }
}
