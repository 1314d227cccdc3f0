//! Tests that pipes and devices in place of files block nothing.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::thread::yield_now;

use rustix::fs::{Mode, OFlags, fcntl_setfl};
use rustix::process::{Pid, Signal, kill_process};
use shm_config::run::RunPaths;
use tempfile::TempDir;

use crate::common;

/// A working folder, children that do nothing, and a run name of one test.
struct Bench {
    dir: TempDir,
    binaries: TempDir,
    run: String,
}

impl Bench {
    fn new(label: &str) -> Self {
        Self {
            dir: tempfile::tempdir().expect("a temporary folder"),
            binaries: common::binaries("idle"),
            run: format!("x{}-{label}", std::process::id()),
        }
    }

    /// Runs under `timeout`, which ends a program that hangs, so that it has no exit
    /// code.
    fn command(&self, words: &[&str]) -> Command {
        let mut command = Command::new("timeout");
        command
            .args([
                "--signal=KILL",
                "60",
                env!("CARGO_BIN_EXE_vlaps-supervisor"),
            ])
            .args(words)
            .current_dir(self.dir.path())
            .env("VLAPS_BIN_DIR", self.binaries.path());
        command
    }

    fn refuses(&self, words: &[&str], parts: &[&str]) {
        let output = self.command(words).output().expect("it runs");
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {text}");
        assert_eq!(text.lines().count(), 1, "{text}");
        for part in parts {
            assert!(text.contains(part), "'{part}' is missing in: {text}");
        }
    }

    fn pipe(&self, name: &str) -> PathBuf {
        let path = self.dir.path().join(name);
        let made = Command::new("mkfifo").arg(&path).status();
        assert!(made.is_ok_and(|status| status.success()));
        path
    }

    /// Starts a set and waits until its children run.
    fn up(&self, words: &[&str]) -> Child {
        let up = common::supervisor()
            .args(["up", "--run", &self.run])
            .args(words)
            .current_dir(self.dir.path())
            .env("VLAPS_BIN_DIR", self.binaries.path())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("it runs");
        while common::arguments(self.binaries.path(), "vlaps-planner").is_empty() {
            yield_now();
        }
        up
    }

    fn paths(&self) -> RunPaths {
        RunPaths::new(self.run.parse().expect("a name"))
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _ = self.paths().clean_if_dead();
        self.paths().remove_dir();
    }
}

fn signal(child: &Child, signal: Signal) {
    kill_process(Pid::from_child(child), signal).expect("it lives");
}

/// The reading end of a pipe that does not wait for a writer.
fn reader(pipe: &PathBuf) -> File {
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let file = rustix::fs::open(pipe, flags, Mode::empty()).expect("a reader");
    File::from(file)
}

#[test]
fn keys_come_from_a_regular_file_of_bounded_size() {
    let bench = Bench::new("keys");
    bench.pipe("pipe");
    let large = "1.0 space\n".repeat((1 << 20) / 10 + 1);
    fs::write(bench.dir.path().join("large"), large).expect("written");
    let up = |keys| ["up", "--run", &bench.run, "--gate", "human", "--keys", keys];
    for special in ["pipe", "/dev/zero"] {
        bench.refuses(&up(special), &[special, "is no regular file"]);
    }
    bench.refuses(&up("large"), &["large", "1048576 bytes"]);
    assert!(!bench.paths().dir().exists());
}

#[test]
fn a_pipe_without_a_reader_is_refused_before_anything_starts() {
    let bench = Bench::new("noread");
    bench.pipe("pipe");
    let parts = ["--json pipe", "nothing reads the pipe"];
    bench.refuses(&["up", "--run", &bench.run, "--json", "pipe"], &parts);
    bench.refuses(&["status", "--json", "pipe"], &parts);
    assert!(!bench.paths().dir().exists());
}

#[test]
fn a_pipe_with_a_reader_gets_the_summary() {
    let bench = Bench::new("read");
    let mut reader = reader(&bench.pipe("pipe"));
    let up = bench.up(&["--json", "pipe"]);
    signal(&up, Signal::TERM);
    fcntl_setfl(&reader, OFlags::empty()).expect("it waits for text");
    let mut text = String::new();
    reader.read_to_string(&mut text).expect("read");
    let output = up.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(json["ended"], "stopped");
}

#[test]
fn a_shells_own_pipe_gets_it_too() {
    let bench = Bench::new("shell");
    common::replace(bench.binaries.path(), "vlaps-planner", "refuse");
    let program = env!("CARGO_BIN_EXE_vlaps-supervisor");
    let line = format!(
        "{program} up --run {} --json >(cat > out; echo > read)",
        bench.run
    );
    let output: Output = Command::new("bash")
        .args(["-c", &line])
        .current_dir(bench.dir.path())
        .env("VLAPS_BIN_DIR", bench.binaries.path())
        .output()
        .expect("bash");
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    while !bench.dir.path().join("read").exists() {
        yield_now();
    }
    let text = fs::read_to_string(bench.dir.path().join("out")).expect("written");
    let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let ended = json["ended"].as_str().expect("words");
    assert!(ended.contains("no such lane"), "{ended}");
}

#[test]
fn a_signal_ends_what_still_writes_when_the_set_is_down() {
    for (stop, code) in [(Signal::INT, 130), (Signal::TERM, 143), (Signal::HUP, 129)] {
        let bench = Bench::new("late");
        let pipe = bench.pipe("pipe");
        // The pipe has a reader that never reads, and is full.
        let _reader = reader(&pipe);
        let up = bench.up(&["--json", "pipe"]);
        let flags = OFlags::WRONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let full = rustix::fs::open(&pipe, flags, Mode::empty()).expect("a writer");
        while File::from(full.try_clone().expect("a descriptor"))
            .write(&[b' '; 4096])
            .is_ok()
        {}
        signal(&up, stop);
        // When the set has ended its files are gone; then the supervisor blocks in the
        // write.
        let state = format!("/proc/{}/wchan", up.id());
        while bench.paths().dir().exists()
            || !fs::read_to_string(&state).is_ok_and(|state| state.contains("pipe"))
        {
            yield_now();
        }
        signal(&up, stop);
        let output = up.wait_with_output().expect("it ends");
        assert_eq!(output.status.code(), Some(code), "{output:?}");
    }
}

#[test]
fn a_second_signal_ends_with_its_number() {
    for (first, second, code) in [
        (Signal::INT, Signal::TERM, 143),
        (Signal::TERM, Signal::INT, 130),
    ] {
        let bench = Bench::new("second");
        common::replace(bench.binaries.path(), "vlaps-planner", "stubborn");
        let up = bench.up(&[]);
        signal(&up, first);
        // Of two signals that wait together, the handler of either may run first.
        let log = format!("runs/{}/logs/supervisor.log", bench.run);
        let log = bench.dir.path().join(log);
        while !fs::read_to_string(&log).is_ok_and(|text| text.contains("a second signal kills")) {
            yield_now();
        }
        signal(&up, second);
        let output = up.wait_with_output().expect("it ends");
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{text}");
        assert!(text.contains("killed by a second signal"), "{text}");
    }
}
