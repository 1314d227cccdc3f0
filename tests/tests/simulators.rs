//! ir-sim, the F1TENTH gym and CommonRoad as worlds. Without the Python environment of one, which
//! `./vlaps setup` creates, its tests print that and pass.

use std::path::{Path, PathBuf};
use std::process::Command;

use shm_config::config::Simulator;
use supervisor::setup::foreign::Foreign;
use vlaps_tests::{Set, programs};

/// A simulator in Python: its row of the supervisor's table.
struct World(Simulator);

impl World {
    fn row(&self) -> &'static Foreign {
        Foreign::of(self.0).expect("a row of the table")
    }

    /// The Python of the environment; `None`, with the reason on stderr, when there is
    /// none.
    fn python(&self) -> Option<PathBuf> {
        let beside = programs().parent().expect("the build's folder").to_owned();
        let home = match std::env::var_os(self.row().home_variable) {
            Some(home) => home.into(),
            None => beside.join(self.row().part()),
        };
        if !home.join("installed.txt").is_file() {
            let (home, word) = (home.display(), self.row().part());
            eprintln!("skipped: {home}: no {word}; run ./vlaps setup {word}");
            return None;
        }
        Some(home.join("bin").join("python"))
    }

    /// Runs the Python tests of the world, and those of what all these worlds use.
    fn test(&self) {
        let Some(python) = self.python() else { return };
        for folder in [self.row().folder, "sim/foreign"] {
            let mut command = Command::new(&python);
            let discover = ["-B", "-m", "unittest", "discover", "-s"];
            command.args(discover).arg(checkout().join(folder));
            let output = command.output().expect("Python starts");
            assert!(output.status.success(), "{folder}: {output:?}");
        }
    }

    /// Drives the 1:10 car with `mpc` over an episode: the digest of its commands.
    fn drive(&self, label: &str, seed: &str) -> String {
        let file = checkout().join("vehicles/car-1-10.toml");
        let file = file.canonicalize().expect("a vehicle file");
        let file = file.display().to_string();
        let set = Set::new(label);
        let world = [
            "--world",
            self.row().part(),
            "--lockstep",
            "--driver",
            "mpc",
        ];
        let length = ["--vehicle", &file, "--seed", seed, "--episodes", "1"];
        let output = set.run(&[&world[..], &length[..]].concat());
        assert!(output.status.success(), "{output:?}\n{}", set.logs());
        let json = set.json();
        let episode = &json["episodes"][0];
        assert_eq!(episode["outcome"], "arrived", "seed {seed}: {episode}");
        assert_eq!(episode["strict"], true, "seed {seed}: {episode}");
        assert_eq!(json["restarts"], 0, "{json}");
        let digest = json["command_digest"].as_str();
        digest.expect("a digest").to_string()
    }

    fn drives_alike(&self, [first, again, other]: [&str; 3]) {
        if self.python().is_none() {
            return;
        }
        let digest = self.drive(first, "1000");
        assert_eq!(digest, self.drive(again, "1000"));
        assert_ne!(digest, self.drive(other, "1001"));
    }
}

fn checkout() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

#[test]
fn ir_sim_scans_moves_and_judges_as_the_world_expects() {
    World(Simulator::IrSim).test();
}

#[test]
fn the_gym_scans_moves_and_judges_as_the_world_expects() {
    World(Simulator::F1tenth).test();
}

#[test]
fn commonroad_reads_moves_and_judges_as_the_world_expects() {
    World(Simulator::CommonRoad).test();
}

#[test]
fn the_small_car_arrives_in_ir_sim_with_the_same_commands_each_time() {
    World(Simulator::IrSim).drives_alike(["ir-a", "ir-b", "ir-c"]);
}

#[test]
fn the_small_car_drives_its_laps_in_the_gym_with_the_same_commands_each_time() {
    World(Simulator::F1tenth).drives_alike(["f1-a", "f1-b", "f1-c"]);
}
