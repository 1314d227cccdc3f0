//! Trainings and sweeps in parts: killed, resumed, merged; the table is that of one
//! process, bit by bit.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;
use vlaps_tests::{programs, until};

/// Parts of the sweep, and those that are killed.
const OF: u32 = 8;
const KILLED: [u32; 3] = [1, 4, 8];
/// Rows of a sweep, each with one seed here.
const TRAININGS: usize = 9;

/// Small nets and short episodes, because the test does not depend on how they drive. Two
/// blocks, so that a kill is within a training.
const SETTINGS: [&str; 5] = [
    "learner.block_steps=100",
    "learner.updates=10",
    "learner.batch=32",
    "learner.hidden=32",
    "world.horizon_ticks=60",
];

fn lab(command: &str, folder: &Path, words: &[&str]) -> Command {
    let mut lab = Command::new(programs().join("vlaps-lab"));
    lab.arg(command)
        .args(words)
        .current_dir(folder)
        .env("VLAPS_COMMIT", "0123abc")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    lab
}

fn with_settings(mut command: Command) -> Command {
    for setting in SETTINGS {
        command.args(["--set", setting]);
    }
    command
}

fn run(mut command: Command) -> (Output, String) {
    let output = command.output().expect("it starts");
    let text = [&output.stdout[..], &output.stderr].concat();
    let text = String::from_utf8_lossy(&text).into_owned();
    (output, text)
}

fn json(path: PathBuf) -> Value {
    let text = fs::read_to_string(path).expect("the JSON was written");
    serde_json::from_str(&text).expect("JSON")
}

/// A folder in the system's folder for temporary files; removed at the end.
fn place(label: &str) -> tempfile::TempDir {
    let prefix = format!("vlaps-tests-{label}");
    tempfile::Builder::new()
        .prefix(&prefix)
        .tempdir()
        .expect("a folder")
}

/// Waits until a training drives in one of the folders, kills it, and returns its steps.
fn kill_in_training(mut command: Command, drives: impl Fn() -> bool) {
    let mut child = command.spawn().expect("it starts");
    until("a training drives", || {
        assert!(
            child.try_wait().expect("a child").is_none(),
            "it ended early"
        );
        drives()
    });
    child.kill().expect("killed");
    child.wait().expect("an end");
}

/// Number of trainings with a first block in a folder of a sweep.
fn begun(out: &Path) -> usize {
    let rows = fs::read_dir(out).into_iter().flatten().flatten();
    rows.filter(|row| {
        let blocks = row.path().join("seed-0/learner/blocks.csv");
        fs::read_to_string(blocks).is_ok_and(|text| text.lines().count() > 1)
    })
    .count()
}

#[test]
fn a_sweep_in_parts_with_three_killed_has_the_table_of_one_process() {
    let place = place("sweep");
    let words = ["--steps", "200", "--final-episodes", "5", "--out"];
    let one = [&words[..], &["one", "--json", "one.json"]].concat();
    let (output, told) = run(with_settings(lab("sweep", place.path(), &one)));
    assert!(output.status.success(), "{told}");
    let out = place.path().join("parts");
    for shard in 1..=OF {
        let name = format!("{shard}/{OF}");
        let part = || {
            let words = [&words[..], &["parts", "--shard", &name]].concat();
            with_settings(lab("sweep", place.path(), &words))
        };
        if KILLED.contains(&shard) {
            let before = begun(&out);
            kill_in_training(part(), || begun(&out) > before);
        }
        let (output, told) = run(part());
        assert!(output.status.success(), "shard {name}: {told}");
        assert!(told.contains("complete, "), "shard {name}: {told}");
        let (_, again) = run(part());
        assert!(again.contains("complete already"), "shard {name}: {again}");
    }
    let report = ["--out", "parts", "--report", "--json", "parts.json"];
    let (output, told) = run(lab("sweep", place.path(), &report));
    assert!(output.status.success(), "{told}");
    let one = json(place.path().join("one.json"));
    let parts = json(place.path().join("parts.json"));
    assert_eq!(parts["rows"], one["rows"]);
    assert_eq!(parts["rows"].as_array().map(Vec::len), Some(TRAININGS));
    assert_eq!(parts["steps"], one["steps"]);
    let picture = |name: &str| fs::read(place.path().join(name).join("sweep.svg"));
    assert_eq!(
        picture("parts").expect("drawn"),
        picture("one").expect("drawn")
    );
}

#[test]
fn a_training_in_parts_has_the_policies_of_one_process_and_tells_what_is_missing() {
    let place = place("train");
    let words = [
        "--algorithm",
        "hg-dagger",
        "--expert",
        "informed",
        "--steps",
        "400",
        "--eval-episodes",
        "2",
        "--final-episodes",
        "3",
        "--seeds",
        "3",
        "--out",
    ];
    let one = [&words[..], &["one", "--json", "one.json"]].concat();
    let (output, told) = run(with_settings(lab("train", place.path(), &one)));
    assert!(output.status.success(), "{told}");
    let part = |shard: &str| {
        let words = [&words[..], &["parts", "--shard", shard]].concat();
        with_settings(lab("train", place.path(), &words))
    };
    let report = || {
        let words = ["--out", "parts", "--report", "--json", "parts.json"];
        run(lab("train", place.path(), &words))
    };
    let blocks = place.path().join("parts/seed-2/learner/blocks.csv");
    kill_in_training(part("2/2"), || {
        fs::read_to_string(&blocks).is_ok_and(|text| text.lines().count() > 1)
    });
    let (output, told) = report();
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("shards 1/2, 2/2"), "{told}");
    for shard in ["1/2", "2/2"] {
        let (output, told) = run(part(shard));
        assert!(output.status.success(), "{told}");
    }
    let (output, told) = report();
    assert!(output.status.success(), "{told}");
    let figures = |name: &str| json(place.path().join(name));
    assert_eq!(figures("parts.json"), figures("one.json"));
    for seed in 0..3 {
        let file = format!("seed-{seed}/learner/policies/00000400.onnx");
        let policy = |name: &str| fs::read(place.path().join(name).join(&file)).expect("a policy");
        assert!(policy("parts") == policy("one"), "{file}");
    }
    // A training that is copied in part counts as missing, and is trained again.
    fs::remove_file(place.path().join("parts/seed-0/final.json")).expect("removed");
    let (output, told) = report();
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(
        told.contains("seed-0: is not the complete training"),
        "{told}"
    );
    let (output, told) = run(part("1/2"));
    assert!(output.status.success(), "{told}");
    assert!(report().0.status.success());
    assert_eq!(figures("parts.json"), figures("one.json"));
    // Neither kind of experiment continues the other.
    let resume = ["--out", "parts", "--resume"];
    let (output, told) = run(lab("train", place.path(), &resume));
    assert_eq!(output.status.code(), Some(2), "{told}");
    assert!(told.contains("contains shards"), "{told}");
    let words = [&words[..], &["one", "--shard", "1/2"]].concat();
    let (output, told) = run(with_settings(lab("train", place.path(), &words)));
    assert_eq!(output.status.code(), Some(2), "{told}");
    assert!(told.contains("began without --shard"), "{told}");
}
