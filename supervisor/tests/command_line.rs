//! Tests of the built program through its command line.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::thread::yield_now;

use rustix::process::{Pid, Signal, kill_process};
use shm_config::judged::{Judged, SUMMARY};
use shm_config::run::{RunName, RunPaths};
use tempfile::TempDir;

use crate::common;

/// A working folder, script children, and a run name of one test.
struct Bench {
    dir: TempDir,
    binaries: TempDir,
    run: String,
}

impl Bench {
    fn new(label: &str, script: &str) -> Self {
        Self {
            dir: tempfile::tempdir().expect("a temporary folder"),
            binaries: common::binaries(script),
            run: format!("s{}-{label}", std::process::id()),
        }
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = common::supervisor();
        command
            .args(arguments)
            .current_dir(self.dir.path())
            .env("VLAPS_BIN_DIR", self.binaries.path());
        command
    }

    fn vlaps(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("it runs")
    }

    fn up(&self) -> Child {
        // An earlier start may have left its file.
        let _ = fs::remove_file(self.binaries.path().join("vlaps-planner.arguments"));
        let mut command = self.command(&["up", "--run", &self.run]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let up = command.spawn().expect("it runs");
        while common::arguments(self.binaries.path(), "vlaps-planner").is_empty() {
            yield_now();
        }
        up
    }

    fn paths(&self) -> RunPaths {
        RunPaths::new(self.run.parse::<RunName>().expect("a name"))
    }

    fn assert_nothing_left(&self) {
        assert!(!self.paths().dir().exists(), "{:?}", self.paths().dir());
        let files = self.paths().shared_memory().expect("shared memory");
        assert!(files.is_empty(), "{files:?}");
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _ = self.paths().clean_if_dead();
        self.paths().remove_dir();
    }
}

/// Asserts one line on stderr with all these parts, and this exit code.
fn assert_error(output: &Output, code: i32, parts: &[&str]) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert_eq!(text.lines().count(), 1, "{text}");
    for part in parts {
        assert!(text.contains(part), "'{part}' is missing in: {text}");
    }
}

fn signal(child: &Child, signal: Signal) {
    kill_process(Pid::from_child(child), signal).expect("it lives");
}

#[test]
fn a_bad_configuration_ends_in_one_line_that_names_it() {
    let bench = Bench::new("bad", "idle");
    let file = |text: &str| fs::write(bench.dir.path().join("a.toml"), text).expect("written");
    let up = |more: &[&str]| {
        let arguments: Vec<_> = ["up", "--run", &bench.run]
            .iter()
            .chain(more)
            .copied()
            .collect();
        bench.vlaps(&arguments)
    };
    file("[run]\nsed = 3\n");
    let parts = [
        "a.toml",
        "unknown key 'run.sed'",
        "did you mean 'run.seed'?",
    ];
    assert_error(&up(&["--config", "a.toml"]), 2, &parts);
    file("[run]\nseed = 3\nrate_hz = \"fast\"\n");
    assert_error(
        &up(&["--config", "a.toml"]),
        2,
        &[
            "a.toml:3",
            "run.rate_hz = \"fast\": must be within 10 and 1000",
        ],
    );
    file("[run]\nrate_hz = 1e6\n");
    let parts = ["a.toml", "run.rate_hz = 1000000", "within 10 and 1000"];
    assert_error(&up(&["--config", "a.toml"]), 2, &parts);
    file("[run\n");
    assert_error(&up(&["--config", "a.toml"]), 2, &["a.toml:1"]);
    assert_error(
        &up(&["--config", "none.toml"]),
        2,
        &["none.toml", "No such file"],
    );
    assert_error(
        &up(&["--set", "gate.perod_s=5"]),
        2,
        &["--set gate.perod_s=5", "did you mean 'gate.period_s'?"],
    );
    assert_error(
        &up(&["--set", "run.seed=x"]),
        2,
        &["--set run.seed=x", "must be a whole number from 0"],
    );
    assert_error(&up(&["--set", "run.seed"]), 2, &["KEY=VALUE"]);
    assert_error(
        &up(&["--rate", "nan"]),
        2,
        &["--rate: run.rate_hz", "within 10 and 1000"],
    );
    assert_error(
        &up(&["--json", "no/such/a.json"]),
        2,
        &["--json no/such/a.json"],
    );
    bench.assert_nothing_left();
}

#[test]
fn an_option_may_correct_a_value_that_is_out_of_range_in_the_file() {
    let bench = Bench::new("mend", "refuse");
    let text = "[run]\nrate_hz = 20.0\n[limits]\nplan_age_ms = 60.0\n";
    fs::write(bench.dir.path().join("vlaps.toml"), text).expect("written");
    let output = bench.vlaps(&["up", "--run", &bench.run]);
    assert_error(&output, 2, &["vlaps.toml", "limits.plan_age_ms = 60"]);
    let output = bench.vlaps(&[
        "up",
        "--run",
        &bench.run,
        "--set",
        "limits.plan_age_ms=300",
        "--set",
        "limits.command_age_ms=400",
        "--gate=expert",
        "--lockstep",
    ]);
    // The configuration is valid, so the child is started and refuses.
    assert_error(&output, 1, &["planner: no such lane"]);
    let resolved = bench
        .dir
        .path()
        .join(format!("runs/{}/config.toml", bench.run));
    let config = shm_config::config::load(&resolved).expect("the resolved configuration");
    assert_eq!(config.run.rate_hz, 20.0);
    assert_eq!(config.limits.command_age_ms, 400.0);
    assert!(config.run.is_lockstep() && !config.gate.has_process());
    bench.assert_nothing_left();
}

#[test]
fn an_unknown_option_is_refused_with_a_suggestion() {
    let bench = Bench::new("option", "idle");
    let output = bench.vlaps(&["up", "--episods", "3"]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2));
    assert!(text.contains("'--episodes'"), "{text}");
    for command in ["up", "down", "status", "doctor", "clean", "config"] {
        let output = bench.vlaps(&[command, "--help"]);
        assert_eq!(output.status.code(), Some(0), "{command}");
        assert!(!output.stdout.is_empty(), "{command}");
    }
}

#[test]
fn a_second_set_of_the_same_name_is_refused_and_the_first_drives_on() {
    let bench = Bench::new("second", "idle");
    let first = bench.up();
    let pid = first.id().to_string();
    let output = bench.vlaps(&["up", "--run", &bench.run]);
    let down = format!("./vlaps down --run {}", bench.run);
    assert_error(&output, 2, &[&pid, &down, "--run OTHER"]);
    let output = bench.vlaps(&["clean", "--run", &bench.run]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(
        text.contains(&format!("run '{}': alive, unchanged", bench.run)),
        "{text}"
    );
    let output = bench.vlaps(&["down", "--run", &bench.run]);
    assert_eq!(output.status.code(), Some(0));
    let output = first.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    bench.assert_nothing_left();
    let output = bench.vlaps(&["down", "--run", &bench.run]);
    assert_eq!(output.status.code(), Some(0));
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("is not running"), "{text}");
}

#[test]
fn a_second_run_in_the_same_folder_is_refused_before_it_writes() {
    let bench = Bench::new("folder", "idle");
    let first = bench.up();
    let folder = bench.dir.path().join("runs").join(&bench.run);
    let before = fs::read_to_string(folder.join("config.toml")).expect("a configuration");
    let other = format!("{}b", bench.run);
    let setting = format!("run.folder={}", folder.display());
    let output = bench.vlaps(&["up", "--run", &other, "--set", &setting]);
    assert_error(&output, 2, &["another run", "run.folder=DIR"]);
    let after = fs::read_to_string(folder.join("config.toml")).expect("a configuration");
    assert_eq!(before, after);
    signal(&first, Signal::TERM);
    assert_eq!(
        first.wait_with_output().expect("it ends").status.code(),
        Some(0)
    );
    bench.assert_nothing_left();
}

#[test]
fn a_supervisors_file_that_was_written_over_hides_no_run() {
    let bench = Bench::new("over", "idle");
    let up = bench.up();
    for junk in ["", "junk", "1\n"] {
        fs::write(bench.paths().supervisor_file(), junk).expect("written over");
        assert_eq!(bench.paths().supervisor_pid(), Some(up.id()), "{junk:?}");
    }
    let output = bench.vlaps(&["down", "--run", &bench.run]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("is stopped"), "{text}");
    assert_eq!(
        up.wait_with_output().expect("it ends").status.code(),
        Some(0)
    );
    bench.assert_nothing_left();
}

#[test]
fn a_set_whose_files_were_removed_reports_it() {
    for (label, lost) in [
        ("nodes", "nodes"),
        ("serv", "services"),
        ("conf", "config.toml"),
    ] {
        let bench = Bench::new(label, "idle");
        let up = bench.up();
        let lost = bench.paths().dir().join(lost);
        match lost.is_dir() {
            true => fs::remove_dir_all(&lost).expect("removed"),
            false => fs::remove_file(&lost).expect("removed"),
        }
        let output = up.wait_with_output().expect("it ends");
        assert_error(
            &output,
            1,
            &["the run's files were removed while it drives"],
        );
        bench.assert_nothing_left();
    }
}

#[test]
fn every_stop_signal_ends_in_order_and_leaves_nothing() {
    for (label, stop) in [
        ("int", Signal::INT),
        ("term", Signal::TERM),
        ("hup", Signal::HUP),
    ] {
        let bench = Bench::new(label, "idle");
        let up = bench.up();
        signal(&up, stop);
        let output = up.wait_with_output().expect("it ends");
        assert_eq!(output.status.code(), Some(0), "{label}: {output:?}");
        bench.assert_nothing_left();
        // Its children drive no tick; a stop as early as this is reported too.
        let text = String::from_utf8_lossy(&output.stdout);
        let ended = format!("run {}: stopped; it drove no tick", bench.run);
        for part in [&ended[..], "logs and summary in "] {
            assert!(text.contains(part), "'{part}' is missing in: {text}");
        }
        let journal = format!("runs/{}/logs/supervisor.log", bench.run);
        let journal = fs::read_to_string(bench.dir.path().join(journal)).expect("a journal");
        assert!(journal.contains("planner: started"), "{journal}");
        assert!(journal.contains("stopping"), "{journal}");
    }
}

#[test]
fn a_killed_set_is_cleaned_by_clean_and_by_the_next_start() {
    let bench = Bench::new("killed", "idle");
    let mut up = bench.up();
    up.kill().expect("killed");
    up.wait().expect("gone");
    assert!(bench.paths().dir().exists());
    let text =
        String::from_utf8_lossy(&bench.vlaps(&["clean", "--run", &bench.run]).stdout).into_owned();
    assert!(
        text.contains(&format!("run '{}': dead, removed", bench.run)),
        "{text}"
    );
    bench.assert_nothing_left();

    let mut up = bench.up();
    up.kill().expect("killed");
    up.wait().expect("gone");
    common::replace(bench.binaries.path(), "vlaps-planner", "refuse");
    let output = bench.vlaps(&["up", "--run", &bench.run]);
    assert_error(&output, 1, &["planner: no such lane"]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("removed what a killed run"), "{text}");
    bench.assert_nothing_left();
}

#[test]
fn a_set_that_dies_too_often_is_given_up() {
    let bench = Bench::new("often", "crash");
    let output = bench.vlaps(&[
        "up",
        "--run",
        &bench.run,
        "--set",
        "supervisor.restarts_max=3",
        "--set",
        "supervisor.backoff_ms=1",
        "--json",
        "a.json",
    ]);
    assert_error(
        &output,
        1,
        &["planner: died (exit code 3)", "the ground gave way"],
    );
    assert_eq!(
        common::arguments(bench.binaries.path(), "vlaps-planner").len(),
        4
    );
    let text = fs::read_to_string(bench.dir.path().join("a.json")).expect("a summary");
    let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(json["restarts"], 3);
    assert!(
        json["ended"]
            .as_str()
            .is_some_and(|ended| ended.starts_with("given up"))
    );
    bench.assert_nothing_left();
}

#[test]
fn a_missing_binary_is_named() {
    let bench = Bench::new("missing", "idle");
    fs::remove_file(bench.binaries.path().join("vlaps-world")).expect("removed");
    let output = bench.vlaps(&["up", "--run", &bench.run]);
    assert_error(&output, 1, &["vlaps-world: missing", "cargo build"]);
    bench.assert_nothing_left();
}

#[test]
fn status_without_a_run_fails_and_creates_nothing() {
    let bench = Bench::new("nothing", "idle");
    let output = bench.vlaps(&["status", "--run", &bench.run]);
    assert_error(&output, 1, &["is not running", "./vlaps up --run"]);
    bench.assert_nothing_left();
}

#[test]
fn status_of_a_silent_set_reports_it_and_does_not_disturb_it() {
    let bench = Bench::new("status", "idle");
    let up = bench.up();
    let output = bench.vlaps(&["status", "--run", &bench.run, "--json", "s.json"]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert!(text.contains("silent"), "{text}");
    let json = fs::read_to_string(bench.dir.path().join("s.json")).expect("written");
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(json["runs"][0]["run"], bench.run.as_str());
    assert_eq!(json["runs"][0]["supervisor"], up.id());
    signal(&up, Signal::TERM);
    let output = up.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    bench.assert_nothing_left();
}

#[test]
fn a_judge_that_gets_no_more_questions_causes_one_warning() {
    let bench = Bench::new("judge", "idle");
    let up = bench.up();
    let folder = bench.dir.path().join("runs").join(&bench.run);
    let judged = Judged {
        supervisor: up.id(),
        trouble: "http_401: no more questions are asked; check the key".into(),
        ..Judged::default()
    };
    let text = serde_json::to_string(&judged).expect("JSON");
    fs::write(folder.join(SUMMARY), text).expect("written");
    let journal = || fs::read_to_string(folder.join("logs/supervisor.log")).unwrap_or_default();
    while !journal().contains("http_401") {
        yield_now();
    }
    signal(&up, Signal::TERM);
    let output = up.wait_with_output().expect("it ends");
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(
        text.matches("warning: the judge: http_401").count(),
        1,
        "{text}"
    );
    bench.assert_nothing_left();
}

#[test]
fn the_printed_configuration_is_valid_and_every_key_is_explained() {
    let bench = Bench::new("keys", "idle");
    let text = String::from_utf8(bench.vlaps(&["config"]).stdout).expect("UTF-8");
    let config = shm_config::config::from_toml(&text, "printed").expect("valid");
    assert_eq!(config, shm_config::config::Config::default());
    let mut before = "";
    for line in text.lines() {
        let is_plain = !line.is_empty() && !line.starts_with('#');
        assert!(!is_plain || before.starts_with('#'), "unexplained: {line}");
        before = line;
    }
    check(&bench, &text, 0);
    check(&bench, "[run]\nsed = 1\n", 2);
}

fn check(bench: &Bench, text: &str, code: i32) {
    let path: &Path = &bench.dir.path().join("checked.toml");
    fs::write(path, text).expect("written");
    let output = bench.vlaps(&["config", "--check", "checked.toml"]);
    assert_eq!(output.status.code(), Some(code), "{output:?}");
}

#[test]
fn the_doctor_prints_a_finding_for_each_check() {
    let bench = Bench::new("doctor", "idle");
    let output = bench.vlaps(&["doctor"]);
    let text = String::from_utf8_lossy(&output.stdout);
    for what in [
        "real-time priority",
        "locked memory",
        "shared memory",
        "cores",
        "isolated cores",
        "kernel",
        "real-time share",
        "CPU governor",
        "processor sleep",
        "clock source",
    ] {
        let named = |line: &&str| {
            line.split_once(' ')
                .is_some_and(|(_, rest)| rest.trim_start().starts_with(what))
        };
        let line = text.lines().find(named);
        let line = line.unwrap_or_else(|| panic!("no {what} in:\n{text}"));
        assert!(
            line.starts_with("OK") || line.starts_with("MISSING"),
            "{line}"
        );
    }
}
