//! A whole process set, driven for a measurement.

use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use shm_config::message::Progress;
use shm_config::run::RunPaths;
use shm_config::secret;
use shm_config::services::{PROGRESS, Process};
use shm_config::wire::{Subscriber, Wire};
use stack::Clock;
use supervisor::machine::signals::pause;
use supervisor::run::leftovers::{Cleaned, clean_run};
pub use supervisor::telemetry::quantiles::Quantiles;

/// Attempts to remove a run's files until its last process has ended, and their interval.
const CLEANINGS: u32 = 100;
const LOOK: Duration = Duration::from_millis(20);
/// Time limit for a set's first message, ns.
pub const START_NS: u64 = 60_000_000_000;

/// The name of a set of this program: other measurements may run at the same time.
pub fn name_of(run: &str) -> String {
    format!("{run}-{}", std::process::id())
}

/// A running set. If the measurement fails, dropping this value kills the set; it also
/// removes the run's files. Drop observers of the run before it.
pub struct Driven {
    child: Child,
    name: String,
    json: PathBuf,
    folder: tempfile::TempDir,
}

impl Driven {
    /// Starts `vlaps-supervisor up` from this program's folder, as a new run in a
    /// temporary folder.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start(
        run: &str,
        arguments: impl IntoIterator<Item = impl Into<OsString>>,
    ) -> anyhow::Result<Self> {
        Self::start_with(run, arguments, None)
    }

    /// The same with a variable in the set's environment.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start_with(
        run: &str,
        arguments: impl IntoIterator<Item = impl Into<OsString>>,
        variable: Option<(&str, OsString)>,
    ) -> anyhow::Result<Self> {
        let folder = tempfile::tempdir()?;
        let name = name_of(run);
        let json = folder.path().join("up.json");
        let supervisor = std::env::current_exe()?.with_file_name("vlaps-supervisor");
        let child = Command::new(&supervisor)
            .args(["up", "--run", &name])
            .args(arguments.into_iter().map(Into::into))
            // The set ends with this process, even if this process is killed.
            .args(["--parent", &std::process::id().to_string()])
            .arg("--json")
            .arg(&json)
            .envs(variable)
            .current_dir(folder.path())
            // The gate may need an API key from the environment.
            .stdin(secret::lend()?)
            .stdout(Stdio::null())
            // This program forwards Ctrl-C; a second signal from the terminal would kill the set.
            .process_group(0)
            .spawn()
            .with_context(|| supervisor.display().to_string())?;
        Ok(Self {
            child,
            name,
            json,
            folder,
        })
    }

    /// The run's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The folder in which the set runs.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The run's folder, with its logs; removed when this value is dropped.
    pub fn run_folder(&self) -> PathBuf {
        self.folder.path().join("runs").join(&self.name)
    }

    /// Process id of the set's supervisor.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Whether the run has ended, successfully or not.
    ///
    /// # Errors
    /// If the process state cannot be read.
    pub fn has_ended(&mut self) -> anyhow::Result<bool> {
        Ok(self.child.try_wait()?.is_some())
    }

    /// Subscribes to the world's progress as soon as the world exists. Drop both before this
    /// set.
    ///
    /// # Errors
    /// If the set does not start in time.
    pub fn listen(&mut self, clock: Clock) -> anyhow::Result<(Wire, Subscriber<Progress>)> {
        let paths = RunPaths::new(self.name.parse()?);
        let until = clock().after_ns(START_NS);
        while paths.supervisor_pid().is_none() {
            if self.has_ended()? || clock() > until {
                bail!("the set does not start; its errors are above");
            }
            pause(LOOK);
        }
        let wire = Wire::join(paths.name(), Process::Supervisor)?;
        let progress = wire.subscriber(PROGRESS)?;
        Ok((wire, progress))
    }

    /// Requests a stop, as Ctrl-C does: the car brakes to a stand first.
    pub fn stop(&self) {
        if let Some(pid) = rustix::process::Pid::from_raw(self.child.id() as i32) {
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        }
    }

    /// Waits for the end; returns the JSON object of `up --json`.
    ///
    /// # Errors
    /// If the run failed.
    pub fn finish(mut self) -> anyhow::Result<Value> {
        self.summary()
    }

    /// As [`Driven::finish`], but keeps the run's folder until this value is dropped.
    ///
    /// # Errors
    /// If the run failed.
    pub fn summary(&mut self) -> anyhow::Result<Value> {
        if !self.child.wait()?.success() {
            bail!("run '{}' failed; its errors are above", self.name);
        }
        let text = std::fs::read_to_string(&self.json)?;
        Ok(serde_json::from_str(&text)?)
    }
}

impl Drop for Driven {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let Ok(name) = self.name.parse() else {
            return;
        };
        // An open observer, or a process that is still being killed, keeps the run alive.
        remove(&RunPaths::new(name));
    }
}

/// Removes a run's files as soon as its last process has ended.
pub fn remove(paths: &RunPaths) {
    for _ in 0..CLEANINGS {
        match clean_run(paths) {
            Ok(Cleaned::Alive) => pause(LOOK),
            Ok(Cleaned::Removed(_)) | Err(_) => return,
        }
    }
}

/// The quantiles under `key` in a process's row of `up --json`; `None` if the process
/// does not measure them.
pub fn quantiles(row: &Value, key: &str) -> Option<Quantiles> {
    Quantiles::deserialize(&row[key]).ok()
}

/// Punctuality of a process in a finished run. Measures that the process does not
/// have are left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Punctuality {
    /// Ticks begun.
    pub ticks: u64,
    /// Ticks of the grid that were skipped.
    pub skipped: u64,
    /// Ticks that ended after their deadline.
    pub late: u64,
    /// Missed ticks: skipped or late.
    pub missed: u64,
    /// From the first tick due to the next one due, s; 0 for a process without a grid.
    pub elapsed_s: f64,
    /// Release lateness: from the scheduled instant to the begin of the tick, us.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lateness_us: Option<Quantiles>,
    /// Wake-up: from the event that released the tick to its begin, us.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wake_up_us: Option<Quantiles>,
    /// From the begin to the end of the tick, us.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub execution_us: Option<Quantiles>,
    /// Real-time priority as the kernel granted it: granted, refused or not asked.
    pub priority: String,
}

impl Punctuality {
    /// Reads the row of `process` from the run's summary.
    pub fn of(summary: &Value, process: &str) -> Self {
        let row = &summary["processes"][process];
        let count = |key: &str| row[key].as_u64().unwrap_or(0);
        let priority = row["realtime"]["priority"].as_str();
        let (skipped, late) = (count("skipped"), count("late"));
        Self {
            ticks: count("ticks"),
            skipped,
            late,
            missed: match process {
                // The world's late instants are those that it misses, at its own rate; they
                // include the run's skipped ticks.
                "world" => late.max(skipped),
                _ => skipped + late,
            },
            elapsed_s: row["elapsed_s"].as_f64().unwrap_or(0.0),
            lateness_us: quantiles(row, "release_lateness_us"),
            wake_up_us: quantiles(row, "wake_up_us"),
            execution_us: quantiles(row, "execution_us"),
            priority: priority.unwrap_or("unknown").into(),
        }
    }
}
