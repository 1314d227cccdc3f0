//! `./vlaps conform`: sound worlds keep every promise, and of a flawed one the right rows
//! are not held. Whether a sound world is punctual is not tested, since the load of this
//! machine decides it. The template drives with the planner and controller of the build.

use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;
use vlaps_tests::{Set, depends_on_load, programs};

/// An example of this crate, which cargo builds before its tests.
fn example(name: &str) -> PathBuf {
    let test = std::env::current_exe().expect("the test's own path");
    let profile = test.ancestors().nth(2).expect("target/PROFILE/deps/TEST");
    profile.join("examples").join(name)
}

fn conform(world: &str, flaw: Option<&str>) -> (Output, Value) {
    conform_with(world, flaw, &[])
}

fn conform_with(world: &str, flaw: Option<&str>, options: &[&str]) -> (Output, Value) {
    let folder = TempDir::new().expect("a folder");
    let mut command = Command::new(programs().join("vlaps-supervisor"));
    command
        .args(["conform", world, "--json", "rows.json"])
        .args(options)
        .current_dir(folder.path());
    if let Some(flaw) = flaw {
        command.env("VLAPS_FLAW", flaw);
    }
    let output = command.output().expect("it runs");
    let text = std::fs::read_to_string(folder.path().join("rows.json")).unwrap_or_default();
    (output, serde_json::from_str(&text).unwrap_or_default())
}

fn shown(output: &Output) -> String {
    let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
    text(&output.stdout) + &text(&output.stderr)
}

/// The promises that are not held.
fn broken(report: &Value) -> Vec<&str> {
    let rows = report["rows"].as_array().expect("rows");
    let rows = rows.iter().filter(|row| row["held"] != true);
    rows.filter_map(|row| row["promise"].as_str()).collect()
}

fn assert_keeps_all(world: &str, options: &[&str]) {
    let (output, report) = conform_with(world, None, options);
    let told = shown(&output);
    let rows = report["rows"].as_array();
    let rows = rows.unwrap_or_else(|| panic!("no rows: {told}"));
    assert!(rows.len() >= 26, "{} rows: {told}", rows.len());
    for row in rows {
        let is_held = row["held"] == true;
        assert!(
            is_held || depends_on_load(row),
            "{world} {options:?}: {row}: {told}"
        );
        assert!(
            row["figure"]
                .as_str()
                .is_some_and(|figure| !figure.is_empty())
        );
    }
    let code = i32::from(!broken(&report).is_empty());
    assert_eq!(
        output.status.code(),
        Some(code),
        "{world} {options:?}: {told}"
    );
    let resumed = rows.iter().find(|row| {
        let promise = row["promise"].as_str();
        promise.is_some_and(|promise| promise.starts_with("is restarted"))
    });
    let figure = resumed.and_then(|row| row["figure"].as_str());
    let killed = figure.and_then(|figure| figure.split("killed at ").nth(1));
    let killed_mps: Option<f64> = killed.and_then(|words| words.strip_suffix(" m/s")?.parse().ok());
    assert!(
        killed_mps.is_some_and(|mps| mps.abs() <= 0.1),
        "killed at a stand: {told}"
    );
}

fn assert_breaks(flaw: &str, promises: &[&str]) {
    let world = example("flawed").display().to_string();
    let (output, report) = conform(&world, Some(flaw));
    let told = shown(&output);
    assert_eq!(output.status.code(), Some(1), "{flaw}: {told}");
    let broken = broken(&report);
    for promise in promises {
        assert!(broken.contains(promise), "{flaw}: '{promise}' held: {told}");
    }
    assert!(told.contains("promises are not held"), "{told}");
}

/// The built-in world, the template, and the template as a small and slow car. All at
/// once: each takes half a minute, in which its processes mostly wait.
#[test]
fn sound_worlds_keep_every_promise() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("slow.toml");
    let car = "[vehicle]\nlength_m = 0.4\nwidth_m = 0.3\nwheelbase_m = 0.25\n\
        max_speed_mps = 0.6\nmax_accel_mps2 = 0.5\nmax_brake_mps2 = 0.4\ndelay_ms = 100.0\n\
        [scanner]\nbeams = 270\nfield_of_view_deg = 270.0\nrange_m = 12.0\n";
    std::fs::write(&file, car).expect("a vehicle file");
    let file = file.display().to_string();
    let template = example("template").display().to_string();
    let slow = ["--vehicle", &file];
    let worlds = [("sim", &[][..]), (&template, &[]), (&template, &slow)];
    std::thread::scope(|scope| {
        for (world, options) in worlds {
            scope.spawn(move || assert_keeps_all(world, options));
        }
    });
}

/// Here all are started at once, too.
#[test]
fn flawed_worlds_are_found() {
    let flaws = [
        (
            "never-brakes",
            &[
                "brakes when commands stop",
                "brakes when the controller is killed",
            ][..],
        ),
        (
            "patient",
            &[
                "brakes when commands stop",
                "refuses a command a minute old",
            ],
        ),
        ("off-grid", &["observations are on the grid"]),
        ("wrong-way", &["steers left for positive steering"]),
        ("one-beam-less", &["shows the scanner of the run"]),
        ("nan-ranges", &["observations are valid"]),
        ("bad-end", &["ends with exit code 0 when asked"]),
    ];
    std::thread::scope(|scope| {
        for (flaw, promises) in flaws {
            scope.spawn(move || assert_breaks(flaw, promises));
        }
    });
}

#[test]
fn a_world_that_dies_at_its_start_is_found() {
    let world = example("flawed").display().to_string();
    let (output, report) = conform(&world, Some("dies-at-start"));
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(broken(&report), ["becomes ready"]);
    let told = shown(&output);
    assert!(told.contains("no lidar on /dev/ttyS7"), "{told}");
}

#[test]
fn a_world_that_cannot_be_started_is_no_test() {
    for (world, why) in [
        ("./nope", "there is no such file"),
        ("/tmp", "is not a file"),
        ("smi", "sim"),
    ] {
        let (output, _) = conform(world, None);
        let told = shown(&output);
        assert_eq!(output.status.code(), Some(2), "{told}");
        assert!(told.contains(why), "{told}");
    }
}

#[test]
fn the_template_is_short_and_drives_its_course_in_lockstep_and_in_real_time() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/template.rs");
    let lines = std::fs::read_to_string(path)
        .expect("the template")
        .lines()
        .count();
    assert!(lines <= 100, "{lines} lines");
    let template = example("template").display().to_string();
    let digests: Vec<String> = (0..2)
        .map(|_| {
            let set = Set::new("ring");
            let output = set.run(&["--world", &template, "--lockstep", "--episodes", "1"]);
            assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
            let json = set.json();
            let episode = &json["episodes"][0];
            assert_eq!(episode["outcome"], "arrived", "{json}");
            assert_eq!(json["braked"], 0, "{json}");
            json["command_digest"].as_str().expect("a digest").into()
        })
        .collect();
    assert_eq!(digests[0], digests[1], "the same drive twice");
    let set = Set::new("ringrt");
    let output = set.run(&["--world", &template, "--duration", "5"]);
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let json = set.json();
    let world = &json["processes"]["world"];
    let number = |key: &str| world[key].as_f64().expect(key);
    let due = (number("elapsed_s") / number("period_s")).round();
    assert_eq!(due, number("ticks") + number("skipped"), "{json}");
    let completion = json["episodes"][0]["completion"].as_f64();
    assert!(completion > Some(0.01), "{json}");
}

#[test]
fn an_error_of_a_robot_is_the_runs_one_line() {
    let world = example("flawed").display().to_string();
    let set = Set::new("flaw");
    let mut command = set.up_command(&[], &["--world", &world]);
    let output = command
        .env("VLAPS_FLAW", "none-such")
        .output()
        .expect("it runs");
    let told = shown(&output);
    assert_eq!(output.status.code(), Some(1), "{told}");
    let line = "world: its program ended before it was ready (exit code 2); its last line: \
                vlaps-world: VLAPS_FLAW=none-such: no such flaw";
    assert!(told.contains(line), "{told}");
}
