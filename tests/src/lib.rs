//! Tests of the whole stack: a harness that drives real process sets.
//!
//! Every set has a run name and a folder of its own, so tests run in parallel.

pub mod two_users;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use std::{env, fs, thread};

use rustix::process::{Pid, Signal, kill_process};
use shm_config::run::{RunName, RunPaths};

/// The folder of the built programs of the profile under test. They are built once
/// here, in case cargo was asked for this package alone, unless `VLAPS_NO_BUILD=1` says to
/// use those that are built.
pub fn programs() -> &'static Path {
    static PROGRAMS: OnceLock<PathBuf> = OnceLock::new();
    PROGRAMS.get_or_init(|| {
        let test = env::current_exe().expect("the test's own path");
        let folder = test.ancestors().nth(2).expect("target/PROFILE/deps/TEST");
        if env::var_os("VLAPS_NO_BUILD").is_some_and(|value| value == "1") {
            return folder.to_path_buf();
        }
        let mut cargo = Command::new(env::var_os("CARGO").unwrap_or("cargo".into()));
        cargo
            // With a test target among them, cargo resolves the features of
            // dependencies as in `cargo test --workspace`, and builds no crate twice.
            .args(["build", "--quiet", "--workspace", "--bins"])
            .args(["--test", "boundaries", "--target-dir"])
            .arg(folder.parent().expect("target/PROFILE"))
            .current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join(".."));
        // Removes the variables that `cargo test` sets for a test's package: `ring`'s
        // build script reads these names, so its dependents would be built again.
        for (name, _) in env::vars_os() {
            let of_this_package = ["CARGO_PKG_", "CARGO_MANIFEST_"]
                .iter()
                .any(|prefix| name.to_string_lossy().starts_with(prefix));
            if of_this_package {
                cargo.env_remove(name);
            }
        }
        if folder.ends_with("release") {
            cargo.arg("--release");
        }
        assert!(cargo.status().expect("cargo").success(), "the build failed");
        folder.to_path_buf()
    })
}

/// A process set of a test, with its run name and folder.
pub struct Set {
    name: RunName,
    folder: PathBuf,
    supervisor: Option<Child>,
}

impl Set {
    /// A name and an empty folder; nothing runs yet.
    pub fn new(label: &str) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("t{}-{count}-{label}", std::process::id());
        let folder = env::temp_dir().join(format!("vlaps-tests-{name}"));
        fs::create_dir_all(&folder).expect("a folder");
        Self {
            name: name.parse().expect("a run name"),
            folder,
            supervisor: None,
        }
    }

    /// The run's name.
    pub fn name(&self) -> &RunName {
        &self.name
    }

    /// The run's place on this machine.
    pub fn paths(&self) -> RunPaths {
        RunPaths::new(self.name.clone())
    }

    /// The folder the set runs in.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The command line of `vlaps up` for this set, under `wrapper` if not empty.
    pub fn up_command(&self, wrapper: &[&str], arguments: &[&str]) -> Command {
        // Under nohup the tests inherit that SIGHUP is ignored, and a supervisor would, too.
        let mut command = Command::new("env");
        command
            .arg("--default-signal=HUP")
            .args(wrapper)
            .arg(programs().join("vlaps-supervisor"));
        command
            .args(["up", "--run", &self.name.to_string(), "--json", "up.json"])
            .args(arguments)
            .current_dir(&self.folder)
            .stdin(Stdio::null());
        command
    }

    /// Starts the set and returns at once.
    pub fn start(&mut self, arguments: &[&str]) {
        let child = self
            .up_command(&[], arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the supervisor starts");
        self.supervisor = Some(child);
    }

    /// Starts the set with a given command line, based on [`Set::up_command`].
    pub fn start_as(&mut self, command: &mut Command) {
        self.supervisor = Some(command.spawn().expect("the supervisor starts"));
    }

    /// Runs the set to its end.
    pub fn run(&self, arguments: &[&str]) -> Output {
        let output = self.up_command(&[], arguments).output();
        output.expect("the supervisor starts")
    }

    /// The JSON that the set has written.
    pub fn json(&self) -> serde_json::Value {
        let path = self.folder.join("up.json");
        let text = fs::read_to_string(&path).unwrap_or_else(|error| {
            panic!("{}: {error}\n{}", path.display(), self.logs());
        });
        serde_json::from_str(&text).expect("JSON")
    }

    /// The output of `status` for the set: its text, and the run of its JSON.
    pub fn status(&self) -> (String, serde_json::Value) {
        let mut command = Command::new(programs().join("vlaps-supervisor"));
        let name = self.name.to_string();
        let words = ["status", "--run", &name, "--json", "status.json"];
        let output = command.args(words).current_dir(&self.folder).output();
        let text = String::from_utf8_lossy(&output.expect("it runs").stdout).into_owned();
        let json = fs::read_to_string(self.folder.join("status.json")).unwrap_or_default();
        let json: serde_json::Value = serde_json::from_str(&json).unwrap_or_default();
        (text, json["runs"][0].clone())
    }

    /// A process of the set in the JSON of `status`; null before its first message.
    pub fn status_of(&self, process: &str) -> serde_json::Value {
        let (_, json) = self.status();
        let rows = json["processes"].as_array().into_iter().flatten();
        let mut found = rows.filter(|row| row["process"] == process);
        found.next().cloned().unwrap_or_default()
    }

    /// Waits for the supervisor's end and gives its exit code.
    pub fn wait(&mut self) -> Option<i32> {
        let mut child = self.supervisor.take().expect("a started set");
        child.wait().expect("an end").code()
    }

    /// Sends the supervisor a signal.
    pub fn signal(&self, signal: Signal) {
        let child = self.supervisor.as_ref().expect("a started set");
        let _ = kill_process(Pid::from_child(child), signal);
    }

    /// Process ids of the set's program, such as `vlaps-planner`.
    pub fn pids(&self, program: &str) -> Vec<i32> {
        pids_within(&self.folder, program)
    }

    /// Sends a signal to the set's program; how many got it.
    pub fn signal_program(&self, program: &str, signal: Signal) -> usize {
        let pids = self.pids(program);
        let sent = pids.iter().filter_map(|pid| Pid::from_raw(*pid));
        sent.filter(|pid| kill_process(*pid, signal).is_ok())
            .count()
    }

    /// All logs of the run, for a failure's message.
    pub fn logs(&self) -> String {
        let folder = self
            .folder
            .join("runs")
            .join(self.name.to_string())
            .join("logs");
        let entries = fs::read_dir(&folder).into_iter().flatten().flatten();
        let texts = entries.map(|entry| {
            let text = fs::read_to_string(entry.path()).unwrap_or_default();
            format!("== {}\n{text}", entry.file_name().display())
        });
        texts.collect()
    }
}

impl Drop for Set {
    fn drop(&mut self) {
        if let Some(mut child) = self.supervisor.take() {
            let _ = child.kill();
            let _ = child.wait();
            until("the children end with their supervisor", || {
                self.pids("").is_empty()
            });
        }
        // A process leaves the list before its last thread has released its locks.
        until("the run is dead", || {
            !matches!(self.paths().clean_if_dead(), Ok(None))
        });
        self.paths().remove_dir();
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Process ids of a program, such as `vlaps-planner`, that runs in a folder or has it
/// among its arguments.
pub fn pids_within(folder: &Path, program: &str) -> Vec<i32> {
    let mark = format!("{}/", folder.display());
    let entries = fs::read_dir("/proc").expect("/proc");
    let mut pids = Vec::new();
    for entry in entries.flatten() {
        let Some(pid) = entry
            .file_name()
            .to_str()
            .and_then(|name| name.parse().ok())
        else {
            continue;
        };
        let line = fs::read(entry.path().join("cmdline")).unwrap_or_default();
        let line = String::from_utf8_lossy(&line);
        let place = fs::read_link(entry.path().join("cwd")).unwrap_or_default();
        let ours = place == folder || line.contains(&mark);
        if ours
            && line
                .split('\0')
                .next()
                .is_some_and(|p| p.ends_with(program))
        {
            pids.push(pid);
        }
    }
    pids
}

/// Polls until `condition` holds.
///
/// # Panics
/// After a minute without it. This is not a speed limit, but ends a test that waits in
/// vain.
pub fn until(what: &str, mut condition: impl FnMut() -> bool) {
    const POLL: Duration = Duration::from_millis(5);
    for _ in 0..12_000 {
        if condition() {
            return;
        }
        thread::park_timeout(POLL);
    }
    panic!("waited a minute in vain until {what}");
}

/// Whether the load of this machine decides if a row of `conform` is held: a world on a
/// loaded machine is not punctual.
pub fn depends_on_load(row: &serde_json::Value) -> bool {
    row["promise"] == "is on time at half of its ticks"
}

/// Runs a test only where `probe` succeeds; says why when it does not.
pub fn skip_unless(probe: &[&str], why: &str) -> bool {
    let works = Command::new(probe[0])
        .args(&probe[1..])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    if !works {
        // Written to the terminal, because a skipped test must not look passed.
        let _ = writeln!(std::io::stderr(), "skipped: {why}");
    }
    !works
}
