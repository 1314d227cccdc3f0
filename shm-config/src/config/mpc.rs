use serde::{Deserialize, Serialize};

use super::{OutOfRange, in_range};
use crate::message::PLANNED_MAX;

/// Model-predictive control on the bicycle model: `planner.method = "mpc"`. The paper
/// gives no numbers for it; each field names the source of its own.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Mpc {
    /// Steps of the horizon. 16 of 0.1 s: path and speed are chosen before for 36 m and
    /// 4 s, so the horizon only follows them; 25 steps drive as well and take half as
    /// long again.
    pub steps: u32,
    /// Length of a step, s; the period of the commands of the experiment.
    #[serde(skip)]
    pub step_s: f64,
    /// Desired speed on a free straight road, m/s. The other traffic drives 8.3; over
    /// 200 maps, 8.0 arrives without contact in 0.970 of them, 6.0 in 0.985.
    pub speed_mps: f64,
    /// Lateral acceleration in bends, m/s². A quarter of the limit of the tyres (11
    /// m/s²).
    #[serde(skip)]
    pub sideways_mps2: f64,
    /// Deceleration used in plans, m/s²; the brake gives four times as much.
    pub brake_mps2: f64,
    /// Distance from obstacles and road edges where there is room, m.
    pub clearance_m: f64,
    /// Distance below which a path counts as blocked, m.
    #[serde(skip)]
    pub contact_m: f64,
    /// Distance from the car's centre to a blocked place at which the car stops, m:
    /// near enough to see past it, far enough to steer past it.
    pub standoff_m: f64,
    /// Expects other cars to turn as they do now, to turn into the road ahead, and to pull
    /// out; without it, to drive straight on. Safer and slower in traffic. A policy learns
    /// no better from it: a single scan does not show how others move.
    pub wary: bool,
    /// Cost of one metre off the path, squared.
    #[serde(skip)]
    pub weight_offset: f64,
    /// Cost of one radian off the path's direction, squared.
    #[serde(skip)]
    pub weight_heading: f64,
    /// Cost of 1 m/s off the wanted speed, squared.
    #[serde(skip)]
    pub weight_speed: f64,
    /// Cost of one radian of wheel angle, squared.
    #[serde(skip)]
    pub weight_steer: f64,
    /// Cost of one radian of change of the wheel angle from step to step, squared.
    #[serde(skip)]
    pub weight_steer_change: f64,
    /// Cost of 1 m/s² of acceleration, squared.
    #[serde(skip)]
    pub weight_accel: f64,
    /// Cost of 1 m/s² of change of acceleration from step to step, squared.
    #[serde(skip)]
    pub weight_accel_change: f64,
    /// Cost of one metre inside the clearance of an obstacle or edge; also the cost of
    /// its square.
    #[serde(skip)]
    pub weight_slack: f64,
    /// The solver stops after this many iterations; it needs 8 to 20.
    #[serde(skip)]
    pub iterations: u32,
    /// The solver stops after this time, ms, and the car follows the last plan. There
    /// is no such limit in lockstep, so that runs repeat.
    pub time_limit_ms: f64,
}

impl Default for Mpc {
    fn default() -> Self {
        Self {
            steps: 16,
            step_s: 0.1,
            speed_mps: 6.0,
            sideways_mps2: 2.5,
            brake_mps2: 3.0,
            clearance_m: 0.6,
            contact_m: 0.1,
            standoff_m: 4.0,
            wary: true,
            weight_offset: 1.0,
            weight_heading: 4.0,
            weight_speed: 0.5,
            weight_steer: 0.5,
            weight_steer_change: 20.0,
            weight_accel: 0.05,
            weight_accel_change: 0.05,
            weight_slack: 100.0,
            iterations: 60,
            time_limit_ms: 10.0,
        }
    }
}

impl Mpc {
    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        in_range("mpc.steps", self.steps, 2..=PLANNED_MAX as u32)?;
        let rows = [
            ("mpc.step_s", self.step_s, 0.02..=0.5),
            ("mpc.speed_mps", self.speed_mps, 0.0..=30.0),
            ("mpc.sideways_mps2", self.sideways_mps2, 0.1..=10.0),
            ("mpc.brake_mps2", self.brake_mps2, 0.1..=10.0),
            ("mpc.clearance_m", self.clearance_m, 0.0..=1.5),
            ("mpc.contact_m", self.contact_m, 0.0..=1.0),
            ("mpc.standoff_m", self.standoff_m, 0.0..=20.0),
            ("mpc.time_limit_ms", self.time_limit_ms, 0.01..=1000.0),
        ];
        for (key, value, range) in rows {
            in_range(key, value, range)?;
        }
        let weights = [
            ("mpc.weight_offset", self.weight_offset),
            ("mpc.weight_heading", self.weight_heading),
            ("mpc.weight_speed", self.weight_speed),
            ("mpc.weight_steer", self.weight_steer),
            ("mpc.weight_steer_change", self.weight_steer_change),
            ("mpc.weight_accel", self.weight_accel),
            ("mpc.weight_accel_change", self.weight_accel_change),
            ("mpc.weight_slack", self.weight_slack),
        ];
        for (key, value) in weights {
            in_range(key, value, 0.0..=1e4)?;
        }
        in_range("mpc.iterations", self.iterations, 1..=200)
    }
}
