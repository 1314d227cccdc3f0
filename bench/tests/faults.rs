//! A short campaign of faults on a running set.

use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process_group};
use serde_json::Value;
use supervisor::machine::signals::pause;

fn campaign(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vlaps-bench"))
        .args(["bench", "faults"])
        .args(words)
        .output()
        .expect("the program starts")
}

fn is_built() -> bool {
    let program = Path::new(env!("CARGO_BIN_EXE_vlaps-bench"));
    let others = [
        "supervisor",
        "world",
        "planner",
        "controller",
        "gate",
        "learner",
    ];
    let missing = |name: &&&str| !program.with_file_name(format!("vlaps-{name}")).exists();
    match others.iter().find(missing) {
        None => true,
        Some(name) => {
            use std::io::Write;
            // Bypasses the capture of test output: a skipped test must not look passed.
            let _ = writeln!(std::io::stderr(), "skipped: vlaps-{name} is not built");
            false
        }
    }
}

#[test]
fn a_short_campaign_writes_a_row_for_each_fault_and_resumes() {
    if !is_built() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("campaign").display().to_string();
    let json = folder.path().join("faults.json");
    let words = ["--seed", "5", "--kinds", "kill,slow,hostile", "--out", &out];
    let first = campaign(&[&words[..], &["--faults", "4"]].concat());
    assert!(first.status.success(), "{first:?}");
    let again = campaign(&[&words[..], &["--faults", "6"]].concat());
    assert!(!again.status.success(), "nothing is overwritten: {again:?}");
    let other = ["--faults", "6", "--resume", "--rate", "20"];
    let other = campaign(&[&words[..], &other].concat());
    assert!(
        !other.status.success(),
        "nor gone on with as another: {other:?}"
    );
    let file = json.display().to_string();
    let more = ["--faults", "6", "--resume", "--json", &file];
    let more = campaign(&[&words[..], &more].concat());
    assert!(more.status.success(), "{more:?}");
    let text = std::fs::read_to_string(&json).expect("the JSON was written");
    let figures: Value = serde_json::from_str(&text).expect("JSON");
    let bars = &figures["bars"];
    assert_eq!(bars["faults"], 6, "{figures}");
    for zero in ["violations", "leftovers", "unaccounted", "wrong"] {
        assert_eq!(bars[zero], 0, "{zero}: {figures}");
    }
    assert!(
        bars["steps"].as_u64() > Some(50),
        "it was watched: {figures}"
    );
    let rows = std::fs::read_to_string(Path::new(&out).join("faults.csv")).expect("rows");
    assert_eq!(rows.lines().count(), 7, "{rows}");
    for picture in ["faults.svg", "faults.png"] {
        assert!(Path::new(&out).join(picture).exists());
    }
}

#[test]
fn a_fault_interrupted_by_ctrl_c_is_repeated() {
    if !is_built() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("campaign").display().to_string();
    let words = [
        "--seed",
        "5",
        "--kinds",
        "kill,hang",
        "--faults",
        "4",
        "--out",
        &out,
    ];
    let mut child = Command::new(env!("CARGO_BIN_EXE_vlaps-bench"))
        .args(["bench", "faults"])
        .args(words)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        // As in a terminal: Ctrl-C signals every process of the group.
        .process_group(0)
        .spawn()
        .expect("the program starts");
    let file = Path::new(&out).join("faults.csv");
    let rows = || std::fs::read_to_string(&file).unwrap_or_default();
    while rows().lines().count() < 2 {
        let ended = child.try_wait().expect("its state");
        assert!(
            ended.is_none(),
            "it ended before the first fault: {ended:?}"
        );
        pause(Duration::from_millis(1));
    }
    kill_process_group(Pid::from_child(&child), Signal::INT).expect("a signal");
    let stopped = child.wait_with_output().expect("its end");
    let message = String::from_utf8_lossy(&stopped.stderr);
    assert_eq!(stopped.status.code(), Some(1), "{message}");
    assert!(
        message.contains("faults are left; --resume continues"),
        "{message}"
    );
    for row in rows().lines().skip(1) {
        assert!(row.ends_with(",ok"), "{row}");
    }
    let resumed = campaign(&[&words[..], &["--resume"]].concat());
    assert!(resumed.status.success(), "{resumed:?}");
    assert_eq!(rows().lines().count(), 5, "{}", rows());
}
