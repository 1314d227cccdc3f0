//! The set that faults befall: started, watched, ended, and looked after for what
//! it leaves.

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
use super::watch::{CHILDREN, Watch};
use crate::driven::remove;
use stack::Clock;

/// From look to look of the watcher.
pub const LOOK: Duration = Duration::from_micros(500);
/// How long a set may take until it drives, and to end, ns.
const PATIENCE_NS: u64 = 30_000_000_000;
/// Steps on fresh inputs in a row: the set drives.
const DRIVING: u32 = 5;

/// How a stage is set.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The run's name.
    pub run: String,
    /// The folder it runs in.
    pub folder: PathBuf,
    /// Ticks per second.
    pub rate_hz: f64,
    /// Seed of its first episode.
    pub seed: u64,
    /// More keys of the configuration.
    pub overrides: Vec<String>,
}

/// A running set with its watcher.
pub struct Stage {
    scene: Scene,
    child: Child,
    watch: Option<Watch>,
    paths: RunPaths,
    clock: Clock,
}

/// How a set ended.
#[derive(Debug, Default)]
pub struct End {
    /// What it left: files, shared memory, processes, sockets.
    pub leftovers: Vec<String>,
    /// What else was wrong.
    pub wrongs: Vec<String>,
}

impl Scene {
    /// The period, ns.
    pub fn period_ns(&self) -> u64 {
        (1e9 / self.rate_hz) as u64
    }

    /// Every key that differs from the defaults. Commands are obeyed for one and a
    /// half periods, so that the vehicle itself brakes within two.
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

    /// What `./vlaps up` makes the set of.
    pub fn words(&self) -> Vec<String> {
        let mut words = vec!["--run".into(), self.run.clone()];
        words.extend(["--seed".into(), self.seed.to_string()]);
        words.extend(["--rate".into(), self.rate_hz.to_string()]);
        for setting in self.settings() {
            words.extend(["--set".into(), setting]);
        }
        words
    }
}

impl Stage {
    /// Starts a set and waits until it drives.
    ///
    /// # Errors
    /// When it does not.
    pub fn start(scene: Scene, clock: Clock) -> anyhow::Result<Self> {
        // What the set before learnt would fill the disk in the end.
        let _ = fs::remove_dir_all(&scene.folder);
        fs::create_dir_all(&scene.folder)?;
        let errors = fs::File::create(scene.folder.join("errors"))?;
        let program = std::env::current_exe()?.with_file_name("vlaps-supervisor");
        let child = Command::new(&program)
            .args(["up", "--json", "up.json"])
            .args(["--parent", &std::process::id().to_string()])
            .args(scene.words())
            .current_dir(&scene.folder)
            // Its gate may need a key.
            .stdin(secret::lend()?)
            .stdout(Stdio::null())
            .stderr(errors)
            // Ctrl-C in the terminal is ours to act on: to the set it would be a fault.
            .process_group(0)
            .spawn()
            .with_context(|| program.display().to_string())?;
        let paths = RunPaths::new(scene.run.parse()?);
        let mut stage = Self {
            scene,
            child,
            watch: None,
            paths,
            clock,
        };
        stage.join()?;
        if !stage.settle(PATIENCE_NS) {
            bail!("the set does not drive: {}", stage.last_words());
        }
        Ok(stage)
    }

    fn join(&mut self) -> anyhow::Result<()> {
        let until = (self.clock)().after_ns(PATIENCE_NS);
        // Its first child comes after it has cleared away what others left: before
        // that, a watcher would look like a living process of the dead run.
        let children = format!("/proc/{0}/task/{0}/children", self.child.id());
        while fs::read_to_string(&children).unwrap_or_default().is_empty() {
            if (self.clock)() > until || self.child.try_wait()?.is_some() {
                bail!("the set does not start: {}", self.last_words());
            }
            pause(LOOK);
        }
        let file = self.scene.folder.join("runs").join(&self.scene.run);
        let config = shm_config::config::load(&file.join("config.toml"))?;
        let name = self.paths.name().clone();
        self.watch = Some(Watch::join(&name, self.child.id(), Limits::of(&config))?);
        Ok(())
    }

    /// The watcher, after a look.
    ///
    /// # Panics
    /// Never: a started stage has one until it ends.
    pub fn watch(&mut self) -> &mut Watch {
        let watch = self.watch.as_mut().expect("watched until its end");
        watch.look(self.clock);
        watch
    }

    /// The controller of this process id dies of the fault that just struck.
    pub fn doom(&mut self, controller: Option<i32>) {
        if let Some(watch) = &mut self.watch {
            watch.doom(controller);
        }
    }

    /// Watches until a condition holds, or for so long; whether it held.
    pub fn until(&mut self, limit_ns: u64, mut holds: impl FnMut(&mut Watch) -> bool) -> bool {
        let until = (self.clock)().after_ns(limit_ns);
        loop {
            if holds(self.watch()) {
                return true;
            }
            if (self.clock)() >= until {
                return false;
            }
            pause(LOOK);
        }
    }

    /// Watches for so long.
    pub fn watch_for(&mut self, moment_ns: u64) {
        self.until(moment_ns, |_| false);
    }

    /// Watches until everybody is up and the car is driven on fresh inputs.
    pub fn settle(&mut self, limit_ns: u64) -> bool {
        let begun = (self.clock)();
        self.watch().fresh_in_row = 0;
        self.until(limit_ns, |watch| {
            let up = CHILDREN
                .into_iter()
                .all(|process| watch.is_up(process, begun));
            up && watch.fresh_in_row >= DRIVING
        })
    }

    /// The process id of a process that was up.
    pub fn pid(&mut self, process: Process) -> Option<i32> {
        match process {
            Process::Supervisor => i32::try_from(self.child.id()).ok(),
            process => self.watch().pid(process),
        }
    }

    /// Sends a signal; whether it went out.
    pub fn signal(&mut self, process: Process, signal: Signal) -> bool {
        let pid = self.pid(process).and_then(Pid::from_raw);
        pid.is_some_and(|pid| kill_process(pid, signal).is_ok())
    }

    /// The supervisor has ended.
    pub fn has_ended(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(Some(_)) | Err(_))
    }

    /// How it is set.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The run's place on the machine.
    pub fn paths(&self) -> &RunPaths {
        &self.paths
    }

    /// Ends the set in an orderly way, and looks at what it leaves and says.
    ///
    /// # Errors
    /// When it cannot be looked at.
    pub fn end(mut self) -> anyhow::Result<End> {
        let mut end = End::default();
        self.watch();
        self.watch = None;
        self.signal_supervisor(Signal::INT);
        let status = self.await_end()?;
        if !status.success() {
            let (exit, words) = (Exit::from(status), self.last_words());
            end.wrongs
                .push(format!("an orderly stop ended with {exit}: {words}"));
        }
        end.wrongs.extend(self.summary_wrongs());
        end.leftovers = self.leftovers(true)?;
        Ok(end)
    }

    /// The supervisor was killed: everything ends with it. What it leaves in
    /// shared memory is removed by the next start.
    ///
    /// # Errors
    /// When it cannot be looked at.
    pub fn bury(mut self) -> anyhow::Result<End> {
        self.watch = None;
        self.await_end()?;
        Ok(End {
            leftovers: self.leftovers(false)?,
            wrongs: Vec::new(),
        })
    }

    /// The supervisor ended by itself, as it should when its run is beyond help.
    ///
    /// # Errors
    /// When it does not end, or cannot be looked at.
    pub fn resign(mut self) -> anyhow::Result<End> {
        self.watch = None;
        let status = self.await_end()?;
        let mut end = End::default();
        if status.code() != Some(1) {
            let exit = Exit::from(status);
            end.wrongs
                .push(format!("a run beyond help ended with {exit}"));
        }
        end.leftovers = self.leftovers(true)?;
        Ok(end)
    }

    /// Ends the set in any state, and removes what it leaves: nothing is
    /// said of a fault that was cut short.
    ///
    /// # Errors
    /// When it does not end.
    pub fn give_up(mut self) -> anyhow::Result<()> {
        self.watch = None;
        self.signal_supervisor(Signal::INT);
        self.await_end()?;
        remove(&self.paths);
        Ok(())
    }

    fn signal_supervisor(&mut self, signal: Signal) {
        // Fails only when it has ended, which is seen next.
        let _ = kill_process(Pid::from_child(&self.child), signal);
    }

    fn await_end(&mut self) -> anyhow::Result<ExitStatus> {
        let until = (self.clock)().after_ns(PATIENCE_NS);
        loop {
            if let Some(status) = self.child.try_wait()? {
                return Ok(status);
            }
            if (self.clock)() > until {
                self.child.kill()?;
                bail!("the set does not end: {}", self.last_words());
            }
            pause(LOOK);
        }
    }

    /// `ticks + skipped == elapsed / period`, in the set's own words.
    fn summary_wrongs(&self) -> Vec<String> {
        let path = self.scene.folder.join("up.json");
        let summary = fs::read_to_string(&path).unwrap_or_default();
        let Ok(summary) = serde_json::from_str::<Value>(&summary) else {
            return vec!["no summary".into()];
        };
        // The planner's turns begin anew with each episode where its rate is lower.
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

    /// What is left of the run on the machine: of an orderly end nothing may be, of
    /// a killed supervisor no process.
    fn leftovers(&self, orderly: bool) -> anyhow::Result<Vec<String>> {
        let mut left = Vec::new();
        // The kernel ends the children of a dead supervisor a moment later.
        let until = (self.clock)().after_ns(2_000_000_000);
        loop {
            let living = living(&self.scene.folder);
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
        for entry in fs::read_dir(&self.scene.folder)?.flatten() {
            let name = entry.file_name();
            if !known.iter().any(|known| name == *known) {
                left.push(shown(entry.path()));
            }
        }
        Ok(left)
    }

    /// The last thing the supervisor said on its standard error.
    fn last_words(&self) -> String {
        let text = fs::read_to_string(self.scene.folder.join("errors")).unwrap_or_default();
        let line = text.lines().rfind(|line| !line.trim().is_empty());
        line.unwrap_or("it said nothing").trim().into()
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        // After its end nothing is left to kill.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Processes that work in a folder or have it in their arguments, zombies left out.
fn living(folder: &Path) -> Vec<String> {
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
