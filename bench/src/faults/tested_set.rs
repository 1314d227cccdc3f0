//! A set under test: starts it, watches it, ends it, and checks what it leaves
//! behind.

use std::fs;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use anyhow::{Context, bail};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use shm_config::run::RunPaths;
use shm_config::secret;
use shm_config::services::Process;
use supervisor::machine::signals::pause;
use supervisor::set::exit::Exit;

use super::ledger::Limits;
use super::monitor::{CHILDREN, Monitor};
use crate::driven::remove;
use stack::Clock;

/// Polling interval of the watcher.
pub const POLL: Duration = Duration::from_micros(500);
/// Time limit for a set to drive, and to end, ns.
const START_END_NS: u64 = 30_000_000_000;
/// A set drives after this many consecutive steps on fresh inputs.
const DRIVING: u32 = 5;

/// Options of a set under test.
#[derive(Debug, Clone)]
pub struct SetOptions {
    /// The run's name.
    pub run: String,
    /// The folder in which it runs.
    pub folder: PathBuf,
    /// Ticks per second.
    pub rate_hz: f64,
    /// Seed of its first episode.
    pub seed: u64,
    /// The words of `up` that name programs in place of those of the build.
    pub programs: Vec<String>,
    /// More configuration keys.
    pub overrides: Vec<String>,
}

/// A running set with its watcher.
pub struct TestedSet {
    options: SetOptions,
    child: Child,
    monitor: Option<Monitor>,
    paths: RunPaths,
    clock: Clock,
}

/// How a set ended.
#[derive(Debug, Default)]
pub struct End {
    /// Files, shared memory, processes and sockets that it left behind.
    pub leftovers: Vec<String>,
    /// Other errors.
    pub errors: Vec<String>,
}

impl SetOptions {
    /// The period, ns.
    pub fn period_ns(&self) -> u64 {
        (1e9 / self.rate_hz) as u64
    }

    /// Every key that differs from the defaults. Commands expire after one and a half
    /// periods, so that the vehicle itself brakes within two.
    fn settings(&self) -> Vec<String> {
        let period_ms = 1e3 / self.rate_hz;
        let mut settings: Vec<String> = [
            "run.faults=true",
            "planner.rate_hz=10",
            "gate.mode=rules",
            "learner.enabled=true",
            "learner.algorithm=hg-dagger",
            "learner.block_steps=2000",
            "learner.updates=5",
            "learner.batch=64",
            "learner.hidden=32",
            "learner.capacity=2000",
            "supervisor.restarts_max=100000",
            "supervisor.healthy_s=0.1",
            "supervisor.backoff_ms=5",
            "supervisor.backoff_max_ms=100",
            "supervisor.silence_s=0.6",
            "supervisor.log_mb=1",
        ]
        .map(String::from)
        .to_vec();
        settings.push(format!("limits.command_age_ms={}", 1.5 * period_ms));
        settings.extend(self.overrides.iter().cloned());
        settings
    }

    /// Arguments of `./vlaps up`.
    pub fn arguments(&self) -> Vec<String> {
        let mut words = vec!["--run".into(), self.run.clone()];
        words.extend(["--seed".into(), self.seed.to_string()]);
        words.extend(["--rate".into(), self.rate_hz.to_string()]);
        words.extend(self.programs.iter().cloned());
        for setting in self.settings() {
            words.extend(["--set".into(), setting]);
        }
        words
    }
}

impl TestedSet {
    /// Starts a set and waits until it drives.
    ///
    /// # Errors
    /// If it does not drive within the time limit.
    pub fn start(options: SetOptions, clock: Clock) -> anyhow::Result<Self> {
        // Recordings and weights of earlier sets would fill the disk in the end.
        let _ = fs::remove_dir_all(&options.folder);
        fs::create_dir_all(&options.folder)?;
        let errors = fs::File::create(options.folder.join("errors"))?;
        let program = std::env::current_exe()?.with_file_name("vlaps-supervisor");
        let child = Command::new(&program)
            .args(["up", "--json", "up.json"])
            .args(["--parent", &std::process::id().to_string()])
            .args(options.arguments())
            .current_dir(&options.folder)
            // The gate may need an API key from the environment.
            .stdin(secret::lend()?)
            .stdout(Stdio::null())
            .stderr(errors)
            // Ctrl-C in the terminal is handled here: to the set it would be a fault.
            .process_group(0)
            .spawn()
            .with_context(|| program.display().to_string())?;
        let paths = RunPaths::new(options.run.parse()?);
        let mut set = Self {
            options,
            child,
            monitor: None,
            paths,
            clock,
        };
        set.join()?;
        if !set.settle(START_END_NS) {
            bail!("the set does not drive: {}", set.last_error());
        }
        Ok(set)
    }

    fn join(&mut self) -> anyhow::Result<()> {
        let until = (self.clock)().after_ns(START_END_NS);
        let child = self.child.id();
        let config = self.paths.config_file();
        while self.paths.supervisor_pid() != Some(child) || !config.exists() {
            if (self.clock)() > until || self.child.try_wait()?.is_some() {
                bail!("the set does not start: {}", self.last_error());
            }
            pause(POLL);
        }
        let config = shm_config::config::load(&config)?;
        let name = self.paths.name().clone();
        self.monitor = Some(Monitor::join(&name, self.child.id(), Limits::of(&config))?);
        Ok(())
    }

    /// The watcher, with everything read that has arrived.
    ///
    /// # Panics
    /// Never: a started set has a watcher until it ends.
    pub fn monitor(&mut self) -> &mut Monitor {
        let monitor = self.monitor.as_mut().expect("watched until its end");
        monitor.look(self.clock);
        monitor
    }

    /// The fault that was just injected kills the controller of this process id.
    pub fn expect_death(&mut self, controller: Option<i32>) {
        if let Some(monitor) = &mut self.monitor {
            monitor.expect_death(controller);
        }
    }

    /// Watches until a condition holds or the time is up; returns whether it held.
    pub fn until(&mut self, limit_ns: u64, mut holds: impl FnMut(&mut Monitor) -> bool) -> bool {
        let until = (self.clock)().after_ns(limit_ns);
        loop {
            if holds(self.monitor()) {
                return true;
            }
            if (self.clock)() >= until {
                return false;
            }
            pause(POLL);
        }
    }

    /// Watches for this time.
    pub fn watch_for(&mut self, moment_ns: u64) {
        self.until(moment_ns, |_| false);
    }

    /// Watches until every process is up and the car is driven on fresh inputs.
    pub fn settle(&mut self, limit_ns: u64) -> bool {
        let begun = (self.clock)();
        self.monitor().fresh_in_row = 0;
        self.until(limit_ns, |monitor| {
            let up = CHILDREN
                .into_iter()
                .all(|process| monitor.is_up(process, begun));
            up && monitor.fresh_in_row >= DRIVING
        })
    }

    /// The process id of a process that has been up.
    pub fn pid(&mut self, process: Process) -> Option<i32> {
        match process {
            Process::Supervisor => i32::try_from(self.child.id()).ok(),
            process => self.monitor().pid(process),
        }
    }

    /// Sends a signal; returns whether it was sent.
    pub fn signal(&mut self, process: Process, signal: Signal) -> bool {
        let pid = self.pid(process).and_then(Pid::from_raw);
        pid.is_some_and(|pid| kill_process(pid, signal).is_ok())
    }

    /// Whether the supervisor has ended.
    pub fn has_ended(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(Some(_)) | Err(_))
    }

    /// The options of this set.
    pub fn options(&self) -> &SetOptions {
        &self.options
    }

    /// The run's files on this machine.
    pub fn paths(&self) -> &RunPaths {
        &self.paths
    }

    /// Stops the set in order; returns what it left behind and other errors.
    ///
    /// # Errors
    /// If that cannot be examined.
    pub fn end(mut self) -> anyhow::Result<End> {
        let mut end = End::default();
        self.monitor();
        self.monitor = None;
        self.signal_supervisor(Signal::INT);
        let status = self.await_end()?;
        if !status.success() {
            let (exit, words) = (Exit::from(status), self.last_error());
            end.errors
                .push(format!("an orderly stop ended with {exit}: {words}"));
        }
        end.errors.extend(self.summary_errors());
        end.leftovers = self.leftovers(true)?;
        Ok(end)
    }

    /// Ends a set whose supervisor was killed: all processes end with it. The files it
    /// leaves in shared memory are removed by the next start.
    ///
    /// # Errors
    /// If what it left cannot be examined.
    pub fn end_killed(mut self) -> anyhow::Result<End> {
        self.monitor = None;
        self.await_end()?;
        Ok(End {
            leftovers: self.leftovers(false)?,
            errors: Vec::new(),
        })
    }

    /// Ends a set whose supervisor should end by itself since the run cannot continue.
    ///
    /// # Errors
    /// If it does not end, or what it left cannot be examined.
    pub fn end_failed(mut self) -> anyhow::Result<End> {
        self.monitor = None;
        let status = self.await_end()?;
        let mut end = End::default();
        if status.code() != Some(1) {
            let exit = Exit::from(status);
            end.errors
                .push(format!("a run that cannot continue ended with {exit}"));
        }
        end.leftovers = self.leftovers(true)?;
        Ok(end)
    }

    /// Ends the set in any state and removes its files, without a result: its fault was
    /// interrupted.
    ///
    /// # Errors
    /// If it does not end.
    pub fn give_up(mut self) -> anyhow::Result<()> {
        self.monitor = None;
        self.signal_supervisor(Signal::INT);
        self.await_end()?;
        remove(&self.paths);
        Ok(())
    }

    fn signal_supervisor(&mut self, signal: Signal) {
        // This fails only if the process has ended, which the next check sees.
        let _ = kill_process(Pid::from_child(&self.child), signal);
    }

    fn await_end(&mut self) -> anyhow::Result<ExitStatus> {
        let until = (self.clock)().after_ns(START_END_NS);
        loop {
            if let Some(status) = self.child.try_wait()? {
                return Ok(status);
            }
            if (self.clock)() > until {
                self.child.kill()?;
                bail!("the set does not end: {}", self.last_error());
            }
            pause(POLL);
        }
    }

    /// Checks `ticks + skipped == elapsed / period` in the set's summary.
    fn summary_errors(&self) -> Vec<String> {
        let path = self.options.folder.join("up.json");
        let summary = fs::read_to_string(&path).unwrap_or_default();
        let Ok(summary) = serde_json::from_str::<Value>(&summary) else {
            return vec!["no summary".into()];
        };
        // At a lower rate, the planner's grid begins anew with each episode.
        ["world", "controller"]
            .iter()
            .filter_map(|process| {
                let row = &summary["processes"][process];
                let number = |key: &str| row[key].as_f64().unwrap_or(f64::NAN);
                let instants = (number("elapsed_s") / number("period_s")).round();
                let counted = number("ticks") + number("skipped");
                let wrong = format!("the summary counts {counted} ticks of {instants}: {process}");
                (instants != counted).then_some(wrong)
            })
            .collect()
    }

    /// What the run left on the machine. An orderly end must leave nothing; a killed
    /// supervisor must leave no process.
    fn leftovers(&self, orderly: bool) -> anyhow::Result<Vec<String>> {
        let mut left = Vec::new();
        // The kernel kills the children of a dead supervisor with a short delay.
        let until = (self.clock)().after_ns(2_000_000_000);
        loop {
            let living = processes_in(&self.options.folder);
            if living.is_empty() || (self.clock)() > until {
                left.extend(living);
                break;
            }
            pause(Duration::from_millis(2));
        }
        if !orderly {
            return Ok(left);
        }
        let shown = |path: PathBuf| path.display().to_string();
        left.extend(self.paths.shared_memory()?.into_iter().map(shown));
        if self.paths.dir().exists() {
            left.push(shown(self.paths.dir()));
        }
        let sockets = fs::read_to_string("/proc/net/unix").unwrap_or_default();
        let place = format!("{}/", self.paths.dir().display());
        let ours = |line: &&str| line.contains(&place);
        left.extend(
            sockets
                .lines()
                .filter(ours)
                .map(|line| format!("socket {line}")),
        );
        let known = ["runs", "up.json", "errors"];
        for entry in fs::read_dir(&self.options.folder)?.flatten() {
            let name = entry.file_name();
            if !known.iter().any(|known| name == *known) {
                left.push(shown(entry.path()));
            }
        }
        Ok(left)
    }

    /// The last line that the supervisor printed to standard error.
    fn last_error(&self) -> String {
        let text = fs::read_to_string(self.options.folder.join("errors")).unwrap_or_default();
        let line = text.lines().rfind(|line| !line.trim().is_empty());
        line.unwrap_or("no error message").trim().into()
    }
}

impl Drop for TestedSet {
    fn drop(&mut self) {
        // A set that has ended has no process to kill.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Processes that work in a folder or have it in their arguments, except zombies.
fn processes_in(folder: &Path) -> Vec<String> {
    let mark = format!("{}/", folder.display());
    let mut living = Vec::new();
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        let name = entry.file_name();
        let Some(pid) = name.to_str().and_then(|name| name.parse::<u32>().ok()) else {
            continue;
        };
        let line = fs::read(entry.path().join("cmdline")).unwrap_or_default();
        let line = String::from_utf8_lossy(&line).replace('\0', " ");
        let place = fs::read_link(entry.path().join("cwd")).unwrap_or_default();
        let ours = place == folder || (line.contains(&mark) && line.contains("vlaps-"));
        if ours && pid != std::process::id() {
            living.push(format!("process {pid}: {line}"));
        }
    }
    living
}
