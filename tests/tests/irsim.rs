//! ir-sim as world. Without its Python environment, which `./vlaps setup ir-sim` creates,
//! these tests print that and pass.

use std::path::{Path, PathBuf};
use std::process::Command;

use vlaps_tests::{Set, programs};

/// The Python of the environment; `None`, with the reason on stderr, when there is
/// none.
fn python() -> Option<PathBuf> {
    let home = match std::env::var_os("VLAPS_IR_SIM") {
        Some(home) => home.into(),
        None => programs()
            .parent()
            .expect("the build's folder")
            .join("ir-sim"),
    };
    if !home.join("installed.txt").is_file() {
        eprintln!(
            "skipped: {}: no ir-sim; run ./vlaps setup ir-sim",
            home.display()
        );
        return None;
    }
    Some(home.join("bin").join("python"))
}

fn checkout() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

#[test]
fn ir_sim_scans_moves_and_judges_as_the_world_expects() {
    let Some(python) = python() else { return };
    let mut command = Command::new(python);
    command
        .args(["-B", "-m", "unittest", "discover", "-s"])
        .arg(checkout().join("sim/irsim"));
    let output = command.output().expect("Python starts");
    assert!(output.status.success(), "{output:?}");
}

#[test]
fn the_small_car_arrives_in_ir_sim_with_the_same_commands_each_time() {
    if python().is_none() {
        return;
    }
    let file = checkout().join("vehicles/car-1-10.toml");
    let file = file.canonicalize().expect("a vehicle file");
    let file = file.display().to_string();
    let drive = |label: &str, seed: &str| {
        let set = Set::new(label);
        let world = ["--world", "ir-sim", "--lockstep", "--driver", "mpc"];
        let length = ["--vehicle", &file, "--seed", seed, "--episodes", "1"];
        let output = set.run(&[&world[..], &length[..]].concat());
        assert!(output.status.success(), "{output:?}\n{}", set.logs());
        let json = set.json();
        let episode = &json["episodes"][0];
        assert_eq!(episode["outcome"], "arrived", "seed {seed}: {episode}");
        assert_eq!(episode["strict"], true, "seed {seed}: {episode}");
        assert_eq!(json["restarts"], 0, "{json}");
        json["command_digest"]
            .as_str()
            .expect("a digest")
            .to_string()
    };
    let first = drive("ir-a", "1000");
    assert_eq!(first, drive("ir-b", "1000"));
    assert_ne!(first, drive("ir-c", "1001"));
}
