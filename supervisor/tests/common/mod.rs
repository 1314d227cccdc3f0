//! Process sets whose children are shell scripts, for tests without ports.

#![allow(dead_code)] // not every test file needs all of it

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, waitid};
use shm_config::Instant;
use shm_config::config::{Config, GateMode};
use shm_config::message::HealthState;
use shm_config::services::Process;
use supervisor::set::launch::{Launch, Program, Resume};
use supervisor::set::privileges::Privileges;
use supervisor::set::process_set::ProcessSet;
use supervisor::set::table::TABLE;
use tempfile::TempDir;

pub const SECOND: u64 = 1_000_000_000;

/// A folder of binaries, all of them links to the checked-in script of this name. A
/// freshly written file could be busy for a moment while another test starts a process.
pub fn binaries(script: &str) -> TempDir {
    let dir = tempfile::tempdir().expect("a temporary folder");
    for row in TABLE {
        replace(dir.path(), row.binary, script);
    }
    dir
}

/// The program. Under nohup the tests inherit that SIGHUP is ignored, and it would, too.
pub fn supervisor() -> Command {
    let mut command = Command::new("env");
    command.args([
        "--default-signal=HUP",
        env!("CARGO_BIN_EXE_vlaps-supervisor"),
    ]);
    command
}

/// Replaces one binary by another script.
pub fn replace(dir: &Path, binary: &str, script: &str) {
    let target = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/children")
        .join(format!("{script}.sh"));
    let link = dir.join(binary);
    let _ = fs::remove_file(&link);
    symlink(target, link).expect("a link");
}

/// A set of script children.
pub struct Rig {
    pub set: ProcessSet,
    pub config: Config,
    pub dir: TempDir,
    pub now: Instant,
}

impl Rig {
    pub fn new(script: &str, change: impl FnOnce(&mut Config)) -> Self {
        Self::with_programs(script, change, |_| Vec::new())
    }

    /// As [`Rig::new`], with other scripts for some binaries.
    pub fn with_others(script: &str, others: &[(&str, &str)]) -> Self {
        let replaced = |dir: &Path| {
            for (binary, other) in others {
                replace(dir, binary, other);
            }
            Vec::new()
        };
        Self::with_programs(script, |_| (), replaced)
    }

    /// As [`Rig::new`], with programs of a user, given the folder of the binaries.
    pub fn with_programs(
        script: &str,
        change: impl FnOnce(&mut Config),
        programs: impl FnOnce(&Path) -> Vec<Program>,
    ) -> Self {
        let dir = binaries(script);
        let mut config = Config::default();
        config.gate.mode = GateMode::Expert;
        change(&mut config);
        let launch = Launch {
            binaries: dir.path().into(),
            config: dir.path().join("config.toml"),
            privileges: Privileges::Ordinary,
            programs: programs(dir.path()),
        };
        let set = ProcessSet::new(&config, launch, dir.path()).expect("a set");
        let now = Instant(SECOND);
        Self {
            set,
            config,
            dir,
            now,
        }
    }

    pub fn pid(&self, process: Process) -> Option<u32> {
        self.set.member(process).expect("in the set").pid()
    }

    pub fn restarts(&self, process: Process) -> u32 {
        self.set.member(process).expect("in the set").restarts()
    }

    pub fn ready(&mut self, process: Process) {
        let pid = self.pid(process).expect("it lives");
        self.set.hear(process, pid, HealthState::Ready);
    }

    /// Starts all processes, one after the other.
    pub fn start_all(&mut self) {
        for process in [Process::Planner, Process::Controller, Process::World] {
            self.set.start_due(self.now, Resume::default());
            self.ready(process);
        }
    }

    /// Waits until a child has ended, without collecting it.
    pub fn await_end(&self, process: Process) {
        await_state(self.pid(process).expect("it lives"), WaitIdOptions::EXITED);
    }

    /// As [`Rig::await_end`]; does nothing if the child was collected already.
    pub fn await_end_if_alive(&self, process: Process) {
        if self.pid(process).is_some() {
            self.await_end(process);
        }
    }

    /// The arguments of each start of a binary, one line each.
    pub fn arguments(&self, binary: &str) -> Vec<String> {
        arguments(self.dir.path(), binary)
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        self.set.signal_all(Signal::KILL);
    }
}

pub fn await_state(pid: u32, state: WaitIdOptions) {
    let pid = Pid::from_raw(pid as i32).expect("a process id");
    waitid(WaitId::Pid(pid), state | WaitIdOptions::NOWAIT).expect("our child");
}

pub fn arguments(dir: &Path, binary: &str) -> Vec<String> {
    let path: PathBuf = dir.join(format!("{binary}.arguments"));
    let text = fs::read_to_string(path).unwrap_or_default();
    text.lines().map(String::from).collect()
}
