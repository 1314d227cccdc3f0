//! Real process sets: a vehicle and those that join it, as a user starts them.

#![allow(dead_code)] // each test program uses a part

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

/// Looks for something that is awaited, one every 50 ms: a minute on a loaded machine.
const LOOKS: u32 = 1_200;

/// The folder of the built programs; `None` where the main build is not beside.
pub fn programs() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_BIN_EXE_vlaps-link")).parent()?;
    let needed = [
        "vlaps-supervisor",
        "vlaps-gate",
        "vlaps-learner",
        "vlaps-world",
    ];
    let is_built = needed.iter().all(|name| folder.join(name).exists());
    if !is_built {
        println!(
            "skipped: no programs of the main build in {}; build them with `cargo build \
             --release --workspace --bins`",
            folder.display()
        );
    }
    is_built.then(|| folder.into())
}

/// A machine, which a test makes of a network namespace or not at all: the words before a
/// program's name that start it there.
pub type Machine = Vec<String>;

/// One test's folder, keys and names.
pub struct Stage {
    pub folder: tempfile::TempDir,
    pub programs: PathBuf,
    name: String,
    /// The vehicle's machine.
    pub vehicle: Machine,
    /// The other one.
    pub other: Machine,
    /// The vehicle's host as the other machine sees it.
    pub host: String,
}

/// A process that a test has started.
pub struct Running {
    pub child: Option<Child>,
    pub log: PathBuf,
}

impl Stage {
    /// `None` when the main build is missing.
    pub fn new() -> Option<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        Some(Self {
            folder: tempfile::tempdir().expect("a folder"),
            programs: programs()?,
            name: format!("t{}-l{number}", std::process::id()),
            vehicle: Vec::new(),
            other: Vec::new(),
            host: "127.0.0.1".into(),
        })
    }

    /// The vehicle's run.
    pub fn run(&self) -> String {
        self.name.clone()
    }

    /// The run on the other machine.
    pub fn other_run(&self) -> String {
        format!("{}j", self.name)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// An address that is free now.
    pub fn address(&self) -> String {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        format!(
            "{}:{}",
            self.host,
            listener.local_addr().expect("an address").port()
        )
    }

    fn command(&self, machine: &Machine, program: &str, words: &[&str]) -> Command {
        let program = self.programs.join(program);
        let mut command = match machine.split_first() {
            None => Command::new(program),
            Some((first, rest)) => {
                let mut command = Command::new(first);
                command.args(rest).arg(program);
                command
            }
        };
        let root = Path::new(env!("CARGO_MANIFEST_DIR"))
            .parent()
            .expect("the root");
        command
            .args(words)
            .current_dir(self.folder.path())
            .env("VLAPS_LINK_KEYS", self.path("keys"))
            .env("VLAPS_ROOT", root)
            .stdin(Stdio::null());
        command
    }

    /// Runs a program of this machine to its end.
    pub fn output(&self, program: &str, words: &[&str]) -> Output {
        self.command(&Vec::new(), program, words)
            .output()
            .expect("it starts")
    }

    /// Starts a program; its output goes to a file.
    pub fn start(&self, machine: &Machine, program: &str, words: &[&str]) -> Running {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let log = self.path(&format!("{program}-{number}.log"));
        let file = std::fs::File::create(&log).expect("a log");
        let child = self
            .command(machine, program, words)
            .stdout(file.try_clone().expect("a log"))
            .stderr(file)
            .spawn()
            .expect("it starts");
        Running {
            child: Some(child),
            log,
        }
    }

    /// Invites a peer; returns the bundle's path.
    pub fn invite(&self, role: &str, address: &str, name: &str) -> String {
        let out = self.path(name).display().to_string();
        let run = self.run();
        let words = [
            "link",
            "invite",
            "--run",
            &run,
            "--as",
            role,
            "--address",
            address,
            "--out",
            &out,
        ];
        let output = self.output("vlaps-link", &words);
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        out
    }

    /// Starts the vehicle's set.
    pub fn up(&self, words: &[&str]) -> Running {
        let run = self.run();
        let json = self.path("up.json").display().to_string();
        let mut all = vec!["up", "--run", &run, "--json", &json, "--seed", "3"];
        all.extend_from_slice(words);
        self.start(&self.vehicle, "vlaps-supervisor", &all)
    }

    /// Joins from the other machine.
    pub fn join(&self, bundle: &str) -> Running {
        let run = self.other_run();
        self.start(&self.other, "vlaps-link", &["join", bundle, "--run", &run])
    }

    /// The summary of the vehicle's set.
    pub fn summary(&self) -> Value {
        let text = std::fs::read_to_string(self.path("up.json")).expect("a summary");
        serde_json::from_str(&text).expect("JSON")
    }

    /// A report of the link; null when there is none yet.
    pub fn report(&self, run: &str, name: &str) -> Value {
        let path = self.path(&format!("runs/{run}/link-{name}.json"));
        let text = std::fs::read_to_string(path).unwrap_or_default();
        serde_json::from_str(&text).unwrap_or_default()
    }

    /// The vehicle's report of a role.
    pub fn vehicle_report(&self, role: &str) -> Value {
        self.report(&self.run(), role)
    }
}

/// A file of the repository.
pub fn file(name: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the root");
    root.join(name).display().to_string()
}

/// Waits until something is so.
pub fn wait_for(what: &str, mut is_so: impl FnMut() -> bool) {
    for _ in 0..LOOKS {
        if is_so() {
            return;
        }
        std::thread::park_timeout(Duration::from_millis(50));
    }
    panic!("waited in vain: {what}");
}

impl Running {
    pub fn text(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// The names of its threads.
    pub fn threads(&self) -> Vec<String> {
        let id = self.child.as_ref().map(Child::id).unwrap_or_default();
        let tasks = std::fs::read_dir(format!("/proc/{id}/task")).expect("it runs");
        tasks
            .flatten()
            .filter_map(|task| std::fs::read_to_string(task.path().join("comm")).ok())
            .collect()
    }

    fn signal(&self, signal: Signal) {
        if let Some(child) = &self.child {
            let _ = kill_process(Pid::from_child(child), signal);
        }
    }

    /// Kills it.
    pub fn kill(&mut self) {
        self.signal(Signal::KILL);
        if let Some(mut child) = self.child.take() {
            let _ = child.wait();
        }
    }

    /// Asks it to end, and waits.
    pub fn end(&mut self) -> Option<i32> {
        self.signal(Signal::TERM);
        self.wait()
    }

    /// Waits for its end.
    pub fn wait(&mut self) -> Option<i32> {
        let mut child = self.child.take()?;
        for _ in 0..LOOKS * 2 {
            if let Ok(Some(status)) = child.try_wait() {
                return status.code();
            }
            std::thread::park_timeout(Duration::from_millis(50));
        }
        let _ = child.kill();
        panic!("it does not end: {}", self.text());
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = kill_process(Pid::from_child(&child), Signal::TERM);
            for _ in 0..200 {
                if !matches!(child.try_wait(), Ok(None)) {
                    return;
                }
                std::thread::park_timeout(Duration::from_millis(50));
            }
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// The messages of a row that a peer of the vehicle has sent or received.
pub fn count(report: &Value, row: &str, way: &str, key: &str) -> u64 {
    let peers = report["peers"].as_array().cloned().unwrap_or_default();
    let own = [report.clone()];
    let all = if peers.is_empty() {
        own.to_vec()
    } else {
        peers
    };
    all.iter()
        .filter_map(|peer| peer["rows"][row][way][key].as_u64())
        .sum()
}

/// Whether a peer is in a session.
pub fn is_joined(report: &Value) -> bool {
    let peers = report["peers"].as_array().cloned().unwrap_or_default();
    peers
        .iter()
        .any(|peer| peer["session"]["is_joined"] == true)
        || report["session"]["is_joined"] == true
}
