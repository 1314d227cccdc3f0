//! The real MetaDrive as world. Without its Python environment, which `./vlaps setup
//! metadrive` creates, these tests print that and pass.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use shm_config::message::{BEAMS_MAX, Bend, FEATURES, Observation};
use vlaps_tests::{Set, programs};

/// Largest difference between a policy input and the simulator's own.
const TOLERANCE: f64 = 1e-5;
/// The same for the position of a checkpoint beyond 50 m. The simulator shortens the
/// vector before it is transformed to the pitching body's frame, `features()` after it:
/// the cosine of the pitch remains.
const TOLERANCE_FAR: f64 = 1e-4;
/// Distance from which a checkpoint counts as far, m; just below 50 for the same
/// reason.
const FAR_M: f64 = 49.99;

/// The Python of the environment; `None`, with the reason on stderr, when there is
/// none.
fn python() -> Option<PathBuf> {
    let home = match std::env::var_os("VLAPS_METADRIVE") {
        Some(home) => home.into(),
        None => programs()
            .parent()
            .expect("the build's folder")
            .join("metadrive"),
    };
    if !home.join("installed.txt").is_file() {
        eprintln!(
            "skipped: {}: no MetaDrive; run ./vlaps setup metadrive",
            home.display()
        );
        return None;
    }
    Some(home.join("bin").join("python"))
}

fn numbers(value: &Value) -> Vec<f64> {
    let list = value.as_array().expect("a list");
    list.iter()
        .map(|number| number.as_f64().expect("a number"))
        .collect()
}

/// A message with the values that the world would have sent.
fn observation(line: &Value) -> Observation {
    let mut observation = Observation::default();
    let ego = numbers(&line["ego"]);
    observation.ego.speed_mps = ego[3];
    observation.ego.yaw_rate_radps = ego[4];
    observation.ego.steer = ego[5];
    observation.ego.pedal = ego[6];
    let road = numbers(&line["road"]);
    observation.road.left_m = road[0];
    observation.road.right_m = road[1];
    observation.road.heading_rad = road[2];
    observation.road.offset_m = road[3];
    for (k, checkpoint) in observation.checkpoints.iter_mut().enumerate() {
        let values = numbers(&line["checkpoints"][k]);
        checkpoint.x_body_m = values[0];
        checkpoint.y_body_m = values[1];
        checkpoint.bend_radius_m = values[2];
        checkpoint.bend_angle_rad = values[3];
        checkpoint.bend = values[4] as u32;
        assert!(Bend::from_code(checkpoint.bend).is_some());
    }
    observation.lidar_max_m = line["lidar_max_m"].as_f64().expect("a range") as f32;
    let ranges_m = numbers(&line["ranges_m"]);
    observation.beam_count = ranges_m.len() as u32;
    for (beam, range_m) in observation.ranges_m.iter_mut().zip(&ranges_m) {
        *beam = *range_m as f32;
    }
    observation
}

fn tolerance(feature: usize, observation: &Observation) -> f64 {
    let far = |k: usize| {
        let checkpoint = &observation.checkpoints[k];
        checkpoint.x_body_m.hypot(checkpoint.y_body_m) > FAR_M
    };
    match feature {
        9 | 10 if far(0) => TOLERANCE_FAR,
        14 | 15 if far(1) => TOLERANCE_FAR,
        _ => TOLERANCE,
    }
}

fn record(python: &Path, arguments: &[&str]) -> String {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sim/metadrive/record.py");
    let mut command = Command::new(python);
    let output = command
        .arg(script)
        .args(arguments)
        .output()
        .expect("Python starts");
    assert!(output.status.success(), "{arguments:?}: {output:?}");
    String::from_utf8(output.stdout).expect("text")
}

fn compare(python: &Path, seed: u64) {
    let text = record(python, &["--seed", &seed.to_string(), "--ticks", "600"]);
    let mut out = [0.0; FEATURES - 240 + BEAMS_MAX];
    let (mut ticks, mut seen, mut worst) = (0, 0, 0.0f64);
    for line in text.lines() {
        let line: Value = serde_json::from_str(line).expect("JSON");
        let observation = observation(&line);
        let ours = observation.features(&mut out).expect("room");
        let theirs = numbers(&line["features"]);
        assert_eq!(ours.len(), theirs.len());
        for (k, (&ours, theirs)) in ours.iter().zip(theirs).enumerate() {
            let error = (f64::from(ours) - theirs).abs();
            worst = worst.max(error);
            assert!(
                error <= tolerance(k, &observation),
                "seed {seed}, tick {ticks}, feature {k}: {ours} against MetaDrive's {theirs}"
            );
        }
        seen += observation
            .ranges()
            .iter()
            .filter(|&&range_m| range_m < 50.0)
            .count();
        ticks += 1;
    }
    // Nothing was compared if the car never drove, or the lidar hit nothing.
    assert!(
        ticks > 50 && seen > 100,
        "seed {seed}: {ticks} ticks, {seen} hits"
    );
    println!("seed {seed}: {ticks} ticks, largest difference {worst:.1e}");
}

#[test]
fn the_message_gives_the_policy_input_of_the_simulator() {
    let Some(python) = python() else { return };
    for seed in [1000, 1003, 1007] {
        compare(&python, seed);
    }
}

#[test]
fn the_world_refuses_bad_commands_as_the_built_in_one_does() {
    let Some(python) = python() else { return };
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sim/metadrive");
    let mut command = Command::new(python);
    command
        .args(["-m", "unittest", "discover", "-s"])
        .arg(sources);
    let output = command.output().expect("Python starts");
    assert!(output.status.success(), "{output:?}");
}

#[test]
fn an_episode_does_not_depend_on_the_one_before() {
    let Some(python) = python() else { return };
    let alone = record(&python, &["--seed", "1003", "--ticks", "150"]);
    let second = record(
        &python,
        &["--seed", "1003", "--ticks", "150", "--after", "1000"],
    );
    assert!(alone.lines().count() > 100);
    assert!(alone == second, "seed 1003 differs after seed 1000");
}

#[test]
fn the_same_seed_gives_the_same_commands_in_metadrive() {
    if python().is_none() {
        return;
    }
    let drive = |label: &str, seed: &str| {
        let set = Set::new(label);
        let world = ["--world", "metadrive", "--lockstep"];
        let length = ["--seed", seed, "--episodes", "2"];
        // Two whole episodes would take minutes on a loaded machine.
        let short = ["--set", "world.horizon_ticks=300"];
        let output = set.run(&[&world[..], &length[..], &short[..]].concat());
        assert!(output.status.success(), "{output:?}\n{}", set.logs());
        let json = set.json();
        assert_eq!(json["skipped"], 0, "{json}");
        assert_eq!(json["restarts"], 0, "{json}");
        assert_eq!(json["ticks"], 600, "{json}");
        json["command_digest"]
            .as_str()
            .expect("a digest")
            .to_string()
    };
    let first = drive("md-a", "1000");
    assert_eq!(first, drive("md-b", "1000"));
    assert_ne!(first, drive("md-c", "1001"));
}
