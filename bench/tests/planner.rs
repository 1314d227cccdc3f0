//! `bench planner`: scenes, their files, the figures.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use shm_config::message::{Message, PlanOutcome};
use stack::scene;

fn bench(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vlaps-bench"))
        .args(words)
        .output()
        .expect("the program starts")
}

fn scratch(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

/// The checked-in file as lines of JSON.
fn lines() -> Vec<String> {
    let path = scratch("whole.jsonl");
    let scenes = scene::checked_in().expect("the checked-in scenes");
    scene::write(&path, &scenes[..3]).expect("written");
    let text = std::fs::read_to_string(&path).expect("text");
    text.lines().map(String::from).collect()
}

#[test]
fn the_checked_in_scenes_are_many_and_mixed() {
    let scenes = scene::checked_in().expect("the checked-in scenes");
    assert!(scenes.len() >= 500, "{}", scenes.len());
    let reached = |scene: &&scene::Scene| scene.origin.outcome == PlanOutcome::Reached;
    let share = scenes.iter().filter(reached).count() as f64 / scenes.len() as f64;
    assert!((0.5..=0.9).contains(&share), "easy and hard ones: {share}");
    for (index, scene) in scenes.iter().enumerate() {
        scene.observation.check().expect("an observation");
        assert_eq!(scene.observation.ranges().len(), 240, "scene {index}");
        let Some(before) = &scene.before else {
            assert_eq!(scene.observation.header.tick, 0, "scene {index}");
            continue;
        };
        let ticks = [before.header.tick + 1, scene.observation.header.tick];
        assert_eq!(ticks[0], ticks[1], "scene {index}");
    }
}

#[test]
fn scenes_survive_a_file_bit_for_bit() {
    let scenes = scene::checked_in().expect("the checked-in scenes");
    for name in ["round.jsonl", "round.jsonl.gz"] {
        let path = scratch(name);
        scene::write(&path, &scenes[..40]).expect("written");
        let again = scene::read(&path).expect("read");
        assert_eq!(again.len(), 40);
        for (one, other) in scenes.iter().zip(&again) {
            assert_eq!(one.origin, other.origin);
            let text = |scene: &scene::Scene| format!("{:?}{:?}", scene.observation, scene.before);
            assert_eq!(text(one), text(other));
        }
    }
}

#[test]
fn recording_is_the_same_each_time_and_keeps_as_many_as_asked() {
    let mut texts = Vec::new();
    for name in ["one.jsonl", "two.jsonl"] {
        let file = scratch(name).display().to_string();
        let output = bench(&[
            "bench",
            "planner",
            "--record",
            &file,
            "--episodes",
            "2",
            "--keep",
            "30",
        ]);
        assert!(output.status.success(), "{output:?}");
        texts.push(std::fs::read_to_string(&file).expect("the scenes"));
    }
    assert_eq!(texts[0].lines().count(), 30);
    assert!(texts[0] == texts[1], "two recordings differ");
}

#[test]
fn a_wrong_file_is_refused_with_line_and_field() {
    let lines = lines();
    let with = |from: &str, to: &str| {
        assert!(lines[1].contains(from), "{from}");
        [&lines[0], &lines[1].replacen(from, to, 1), &lines[2]].map(|line| line.clone() + "\n")
    };
    let speed = "\"speed_mps\":";
    let bars = lines[1].find("\"ranges_m\":[").expect("ranges");
    let half = format!("{}\n{}", lines[0], &lines[1][..bars + 40]);
    let cases = [
        (
            with(speed, "\"speed_mps\":NaN,\"x\":").concat(),
            "line 2: speed_mps",
        ),
        (
            with(speed, "\"speed_mps\":null,\"x\":").concat(),
            "line 2: speed_mps",
        ),
        (
            with(speed, "\"speed_mps\":1e9,\"steer\":0.0,\"x\":").concat(),
            "line 2",
        ),
        (
            with("\"left_m\":", "\"left_m\":\"wide\",\"x\":").concat(),
            "line 2: left_m",
        ),
        (with("\"left_m\":", "\"left\":").concat(), "`left`"),
        (
            with("\"ranges_m\":[", "\"ranges_m\":[-1.0,").concat(),
            "ranges_m = -1",
        ),
        (
            with("\"bend\":\"", "\"bend\":\"up").concat(),
            "checkpoints.bend",
        ),
        (
            with("\"outcome\":\"", "\"outcome\":\"un").concat(),
            "line 2: outcome",
        ),
        (half, "line 2: ranges_m"),
        (String::new(), "no scene in it"),
        ("\n".into(), "line 1"),
        ("car\n".into(), "line 1"),
    ];
    let path = scratch("wrong.jsonl");
    for (text, hint) in cases {
        std::fs::write(&path, &text).expect("written");
        let error = scene::read(&path).expect_err(hint).to_string();
        assert!(error.contains(hint), "{hint}: {error}");
        assert!(error.contains("wrong.jsonl"), "{error}");
    }
}

#[test]
fn a_file_that_is_cut_off_or_missing_is_refused() {
    let scenes = scene::checked_in().expect("the checked-in scenes");
    let path = scratch("cut.jsonl.gz");
    scene::write(&path, &scenes[..20]).expect("written");
    let whole = std::fs::read(&path).expect("bytes");
    for length in [12, whole.len() / 2, whole.len() - 4] {
        std::fs::write(&path, &whole[..length]).expect("written");
        let error = scene::read(&path).expect_err("cut off").to_string();
        assert!(error.contains("cut off in line"), "{length}: {error}");
    }
    let output = bench(&["bench", "planner", "--scenes", "/no/such/file"]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("/no/such/file"), "{text}");
}

/// The rows of a run, without what is a time of this machine.
fn figures(name: &str) -> Value {
    let path = scratch(name);
    let file = path.display().to_string();
    let output = bench(&["bench", "planner", "--rounds", "1", "--json", &file]);
    assert!(output.status.success(), "{output:?}");
    let table = String::from_utf8_lossy(&output.stdout);
    for word in [
        "rrt-star",
        "informed",
        "kinodynamic",
        "mpc",
        "whole plan, us",
        "p99.9",
    ] {
        assert!(table.contains(word), "{word}: {table}");
    }
    let text = std::fs::read_to_string(&path).expect("the JSON was written");
    let mut found: Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(found["conditions"]["rounds"], 1);
    assert!(
        found["conditions"]["scenes"].as_u64() >= Some(500),
        "{found}"
    );
    let rows = found["rows"].as_array_mut().expect("rows");
    assert_eq!(rows.len(), 4);
    for row in rows.iter_mut() {
        let row = row.as_object_mut().expect("an object");
        for phase in ["grid", "search", "plan", "plan_core"] {
            let of = |quantile: &str| row[&format!("{phase}_{quantile}_us")].as_f64();
            let times = ["p50", "p99", "p999", "max"].map(of);
            assert!(
                times.is_sorted() && times[3] > Some(0.0),
                "{phase}: {times:?}"
            );
        }
        row.retain(|key, _| !key.ends_with("_us"));
        for key in ["planner", "cost_median_m", "reached", "partial"] {
            assert!(row.contains_key(key), "{key}");
        }
    }
    found["rows"].take()
}

#[test]
fn the_checked_in_scenes_cost_the_same_each_time() {
    let (one, other) = (figures("planner-1.json"), figures("planner-2.json"));
    assert_eq!(one, other);
    assert_eq!(one[0]["planner"], "rrt-star");
    assert!(one[0]["cost_median_m"].as_f64() > Some(5.0), "{one}");
}

#[test]
fn without_ompl_it_says_what_to_install() {
    // No compiler is on this path.
    let output = Command::new(env!("CARGO_BIN_EXE_vlaps-bench"))
        .args(["bench", "planner", "--rounds", "1", "--ompl"])
        .env("PATH", scratch("no-programs"))
        .output()
        .expect("the program starts");
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("libompl-dev"), "{text}");
    assert!(output.stdout.is_empty(), "nothing half-done: {output:?}");
}
