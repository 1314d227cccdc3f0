//! The machine of the examples `serial` and `can`, simulated, and a run that drives it.

use std::path::PathBuf;
use std::process::Output;

use robot::{Action, Bicycle, Vehicle};
use rustix::time::Timespec;
use vlaps_tests::Set;

use crate::report::Report;

/// Time from report to report, s, and for poll.
pub const STEP_S: f64 = 0.02;
pub const STEP: Timespec = Timespec {
    tv_sec: 0,
    tv_nsec: 20_000_000,
};
/// Steps without an order after which the machine brakes by itself.
const PATIENCE: u32 = 13;
/// Beams of the machine's lidar, and the angle between two of them, degrees.
pub const BEAMS: u32 = 72;
const GAP_DEG: f64 = 5.0;

/// A car in the corridor of the examples.
pub struct Machine {
    car: Bicycle,
    action: Action,
    silent: u32,
}

impl Machine {
    pub fn new() -> Self {
        Self {
            car: Bicycle::new(Vehicle::default()),
            action: Action::BRAKE,
            silent: 0,
        }
    }

    /// How far it came, m.
    pub fn driven_m(&self) -> f64 {
        self.car.state.position.x
    }

    /// Drives for a step by the order that arrived, if one did.
    pub fn step(&mut self, ordered: Option<Action>) {
        self.silent = ordered.map_or(self.silent + 1, |_| 0);
        self.action = ordered.unwrap_or(self.action);
        if self.silent > PATIENCE {
            self.action = Action::BRAKE;
        }
        self.car.advance(self.action, STEP_S);
    }

    /// What it senses with this many beams.
    pub fn report(&self, beams: u32) -> Report {
        let (state, yaw_rate_radps) = (self.car.state, self.car.yaw_rate_radps);
        let ranges_m = (0..beams).map(|beam| {
            let angle_rad = state.heading_rad + (f64::from(beam) * GAP_DEG).to_radians();
            let sin = angle_rad.sin();
            let wall_m = 3.0 - state.position.y * sin.signum();
            (wall_m / sin.abs()) as f32
        });
        Report {
            x_m: state.position.x as f32,
            y_m: state.position.y as f32,
            heading_rad: state.heading_rad as f32,
            speed_mps: state.speed_mps as f32,
            yaw_rate_radps: yaw_rate_radps as f32,
            ranges_m: ranges_m.collect(),
        }
    }
}

/// Runs an example as the world, with the variable that names its line.
pub fn run(set: &Set, example: &str, variable: &str, line: &str) -> Output {
    let test = std::env::current_exe().expect("the test's own path");
    let profile = test.ancestors().nth(2).expect("target/PROFILE/deps/TEST");
    let world: PathBuf = profile.join("examples").join(example);
    let world = world.display().to_string();
    let lidar = format!("scanner.beams={BEAMS}");
    let options = ["--world", &world, "--duration", "6", "--set", &lidar];
    let mut command = set.up_command(&[], &options);
    command.env(variable, line).output().expect("it runs")
}

/// What a run said that was to end well.
pub fn ended_well(set: &Set, output: &Output) {
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{told}{}", set.logs());
}
