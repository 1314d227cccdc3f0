//! Tests that wrong arguments are refused before anything starts, with a helpful
//! message.

use std::fs;
use std::process::{Command, Output};

use tempfile::TempDir;

fn vlaps(folder: &TempDir, words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vlaps-supervisor"))
        .args(words)
        .current_dir(folder.path())
        .output()
        .expect("it runs")
}

/// Asserts exit code 2 and these words on stderr.
fn assert_refused(folder: &TempDir, words: &[&str], parts: &[&str]) {
    let output = vlaps(folder, words);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{words:?}: {text}");
    for part in parts {
        assert!(
            text.contains(part),
            "{words:?}: '{part}' is missing in: {text}"
        );
    }
}

fn pipe(folder: &TempDir, name: &str) {
    let path = folder.path().join(name);
    let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
    let dev = 0;
    rustix::fs::mknodat(
        rustix::fs::CWD,
        &path,
        rustix::fs::FileType::Fifo,
        mode,
        dev,
    )
    .expect("a pipe");
}

#[test]
fn a_pipe_or_device_in_place_of_a_file_is_refused_at_once() {
    let folder = TempDir::new().expect("a folder");
    pipe(&folder, "pipe");
    let parts = ["is no regular file"];
    for path in ["pipe", "/dev/zero", "."] {
        assert_refused(&folder, &["swap", path], &parts);
        assert_refused(&folder, &["config", "--check", path], &parts);
        assert_refused(&folder, &["up", "--config", path], &parts);
    }
    fs::create_dir(folder.path().join("vlaps.toml")).expect("a folder");
    assert_refused(&folder, &["up"], &["vlaps.toml", "is no regular file"]);
}

#[test]
fn places_that_cannot_be_written_are_refused_first() {
    let folder = TempDir::new().expect("a folder");
    for path in ["no/such/a.json", ".", "/proc/a.json"] {
        let parts = [&format!("--json {path}"), "cannot write there"];
        assert_refused(&folder, &["up", "--json", path], &parts);
        assert_refused(&folder, &["status", "--json", path], &parts);
    }
    assert!(!folder.path().join("runs").exists(), "nothing was begun");
}

#[test]
fn numbers_out_of_range_are_told_with_the_range() {
    let folder = TempDir::new().expect("a folder");
    let whole = "must be a whole number from 0";
    assert_refused(&folder, &["up", "--seed", "-1"], &["'-1'", "--seed", whole]);
    assert_refused(&folder, &["up", "--episodes", "-3"], &["'-3'", whole]);
    assert_refused(&folder, &["up", "--seed", "x"], &["'x'", whole]);
    assert_refused(&folder, &["up", "--rate", "-5"], &["run.rate_hz = -5"]);
    assert_refused(
        &folder,
        &["up", "--duration", "-5"],
        &["run.duration_s = -5"],
    );
}

#[test]
fn a_file_without_keys_is_refused_and_capitals_are_read() {
    let folder = TempDir::new().expect("a folder");
    let keys = |text: &str| fs::write(folder.path().join("keys"), text).expect("written");
    let words = ["up", "--gate", "human", "--keys", "keys"];
    for text in ["", "# nothing\n\n"] {
        keys(text);
        assert_refused(&folder, &words, &["--keys keys", "TIME_S KEY"]);
    }
    keys("1.0 SPACE\n2.0 spice\n");
    assert_refused(&folder, &words, &["keys:2: 2.0 spice"]);
}

#[test]
fn a_set_whose_parent_has_gone_does_not_begin() {
    let folder = TempDir::new().expect("a folder");
    let other = i32::MAX.to_string();
    assert_refused(
        &folder,
        &["up", "--parent", &other],
        &["--parent", "has ended"],
    );
}

#[test]
fn a_program_that_cannot_be_started_is_refused_with_its_option() {
    let folder = TempDir::new().expect("a folder");
    fs::create_dir(folder.path().join("folder")).expect("a folder");
    fs::write(folder.path().join("plain"), "text").expect("a file");
    for option in ["--world", "--planner"] {
        let up = |path| vec!["up", option, path];
        let told = |path: &str, why: &str| format!("{option} {path}: {why}");
        for (path, why) in [
            ("./nope", "there is no such file"),
            ("./folder", "is not a file"),
            ("./plain", "is not executable; chmod +x"),
        ] {
            assert_refused(&folder, &up(path), &[&told(path, why)]);
        }
    }
    assert_refused(
        &folder,
        &["up", "--world", "smi"],
        &["sim", "metadrive", "ir-sim", "f1tenth", "commonroad"],
    );
    assert_refused(
        &folder,
        &["up", "--set", "programs.world=./plain"],
        &["programs.world = \"./plain\": must be an absolute path"],
    );
    assert_refused(
        &folder,
        &["up", "--set", "programs.planner=/no/such/planner"],
        &["programs.planner = \"/no/such/planner\": there is no such file"],
    );
    assert_refused(
        &folder,
        &["up", "--judge", "/no/such/judge"],
        &["--judge /no/such/judge: there is no such file"],
    );
    assert_refused(
        &folder,
        &["up", "--gate", "expert", "--set", "programs.gate=/bin/true"],
        &["programs.gate", "gate.mode"],
    );
    assert_refused(
        &folder,
        &["up", "--driver", "mpc", "--planner", "./plain"],
        &["--planner", "cannot be used with", "--driver"],
    );
}
