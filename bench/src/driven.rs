//! A whole process set, driven for a measurement.

use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use shm_config::run::RunPaths;
use shm_config::secret;
use supervisor::machine::signals::pause;
use supervisor::run::leftovers::{Cleaned, clean_run};
pub use supervisor::telemetry::quantiles::Quantiles;

/// Looks until a run's last process has let go of it, and from one to the next.
const CLEANINGS: u32 = 100;
const LOOK: Duration = Duration::from_millis(20);

/// A running set. It is killed should anything fail before it has ended; what its run
/// has left is removed with this value; an observer of the run is dropped before it.
pub struct Driven {
    child: Child,
    name: String,
    json: PathBuf,
    folder: tempfile::TempDir,
}

impl Driven {
    /// Starts `vlaps-supervisor up`, of this program's own build, with a run of
    /// its own in a folder of its own.
    ///
    /// # Errors
    /// When it cannot be started.
    pub fn start(
        run: &str,
        arguments: impl IntoIterator<Item = impl Into<OsString>>,
    ) -> anyhow::Result<Self> {
        let folder = tempfile::tempdir()?;
        let name = format!("{run}-{}", std::process::id());
        let json = folder.path().join("up.json");
        let supervisor = std::env::current_exe()?.with_file_name("vlaps-supervisor");
        let child = Command::new(&supervisor)
            .args(["up", "--run", &name])
            .args(arguments.into_iter().map(Into::into))
            // The set ends with this process, even when that is killed.
            .args(["--parent", &std::process::id().to_string()])
            .arg("--json")
            .arg(&json)
            .current_dir(folder.path())
            // Its gate may need a key.
            .stdin(secret::lend()?)
            .stdout(Stdio::null())
            // This program passes Ctrl-C on: a second one from the terminal would kill.
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

    /// The run's own folder, such as of its logs. It is gone with this value.
    pub fn run_folder(&self) -> PathBuf {
        self.folder.path().join("runs").join(&self.name)
    }

    /// Process id of the set's supervisor.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// The run has ended, well or not.
    ///
    /// # Errors
    /// When the system does not tell.
    pub fn has_ended(&mut self) -> anyhow::Result<bool> {
        Ok(self.child.try_wait()?.is_some())
    }

    /// Asks it to stop, as Ctrl-C does: the car is braked to a stand first.
    pub fn stop(&self) {
        if let Some(pid) = rustix::process::Pid::from_raw(self.child.id() as i32) {
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        }
    }

    /// Waits for the end; what `up --json` wrote.
    ///
    /// # Errors
    /// When the run failed.
    pub fn finish(mut self) -> anyhow::Result<Value> {
        self.summary()
    }

    /// The same, and the run's folder stays for as long as this value.
    ///
    /// # Errors
    /// When the run failed.
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
        // An open observer keeps a run alive, as does a process that is being killed.
        remove(&RunPaths::new(name));
    }
}

/// Removes what a run has left, once its last process has let go of it.
pub fn remove(paths: &RunPaths) {
    for _ in 0..CLEANINGS {
        match clean_run(paths) {
            Ok(Cleaned::Alive) => pause(LOOK),
            Ok(Cleaned::Removed(_)) | Err(_) => return,
        }
    }
}

/// As `up --json` has them under a key of a process, which lacks what the process
/// does not measure.
pub fn quantiles(row: &Value, key: &str) -> Option<Quantiles> {
    Quantiles::deserialize(&row[key]).ok()
}

/// How punctual a process of a finished run was. A measure that it does not have is
/// left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Punctuality {
    /// Ticks.
    pub ticks: u64,
    /// Ticks of the grid skipped.
    pub skipped: u64,
    /// Ticks done after their deadline.
    pub late: u64,
    /// Ticks missed: skipped, or done after their deadline.
    pub missed: u64,
    /// From the first tick due to the next one due, s; 0 of what keeps no grid.
    pub elapsed_s: f64,
    /// Begin of the tick after its instant, us.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lateness_us: Option<Quantiles>,
    /// Begin of the tick after the event that released it, us.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wake_up_us: Option<Quantiles>,
    /// From begin to end of the tick, us.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub execution_us: Option<Quantiles>,
    /// What the kernel granted it: real-time priority.
    pub priority: String,
}

impl Punctuality {
    /// As the run's summary has it.
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
                // Its instants that are late are those that it misses, at a rate of
                // its own; the skipped ticks of the run are among them.
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
