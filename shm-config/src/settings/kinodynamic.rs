use serde::{Deserialize, Serialize};

use super::{OutOfRange, in_range};

/// RRT* over the bicycle, `planner.method = "kinodynamic"`. Grid, budget, speed,
/// goal ball and seed are those of `planner`; the inflation, the corridor's
/// margin, the goal's distance and the radius of a step are its own.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Kinodynamic {
    /// Distance of the body's front and middle from lidar returns, m. 0.25: the safety
    /// check's 0.15, and 10 cm for the tracking error.
    pub clearance_m: f64,
    /// Margin to either edge of the road for the middle line of the body, m; replaces
    /// `planner.lane_margin_m`. 1.5: 0.57 m more than the body's half width (0.926 m),
    /// for cut corners; with 1.0, 3 % of the episodes end on a sidewalk.
    pub lane_margin_m: f64,
    /// Highest lateral acceleration of a curve, m/s²: at the speed v the radius is at
    /// least v²/a, and at least the car's own. 4.0 at 5 m/s is a radius of 6.25 m;
    /// tyres slide above 11.
    #[serde(skip)]
    pub lateral_mps2: f64,
    /// When no path is found at `planner.speed_mps`, the planner searches at this
    /// speed, m/s, which allows tighter curves. 2.5: a radius of 3.1 m with the default
    /// car, whose own radius is 2.94 m.
    #[serde(skip)]
    pub slow_mps: f64,
    /// Deceleration towards the end of a path that does not reach its goal, m/s².
    /// 2.0: a fifth of what the brake can do.
    #[serde(skip)]
    pub brake_mps2: f64,
    /// Largest distance of the goal along the road, m. 20.0: four seconds.
    #[serde(skip)]
    pub goal_distance_m: f64,
    /// How far a bend may deviate from the straight line to the goal while the middle
    /// of the road is free, m. 0.25: as in `planner.goal_sag_m`.
    #[serde(skip)]
    pub goal_sag_m: f64,
    /// Largest heading error of a node in the goal ball relative to the road, rad.
    #[serde(skip)]
    pub goal_heading_rad: f64,
    /// Largest heading of a sample relative to the road, rad. 0.8: to pass an obstacle,
    /// a car with a turning radius of 6.25 m needs 0.7 for a lane of 3.5 m.
    #[serde(skip)]
    pub spread_rad: f64,
    /// Parents are chosen and edges rewired within this distance, m; towards a sample
    /// further away from every node, an edge of this length is made. 10.0: half the
    /// distance to the goal, because a single edge can lead round an obstacle.
    #[serde(skip)]
    pub reach_m: f64,
    /// Share of the samples that are spread evenly over all headings and the whole
    /// road; the others follow the road. 0.1: few, but every pose stays reachable.
    #[serde(skip)]
    pub uniform_share: f64,
}

impl Default for Kinodynamic {
    fn default() -> Self {
        Self {
            clearance_m: 0.25,
            lane_margin_m: 1.5,
            lateral_mps2: 4.0,
            slow_mps: 2.5,
            brake_mps2: 2.0,
            goal_distance_m: 20.0,
            goal_sag_m: 0.25,
            goal_heading_rad: 0.5,
            spread_rad: 0.8,
            reach_m: 10.0,
            uniform_share: 0.1,
        }
    }
}

impl Kinodynamic {
    /// Checks every number.
    ///
    /// # Errors
    /// The first number that is not finite or outside its limits.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let rows = [
            ("kinodynamic.clearance_m", self.clearance_m, 0.0..=2.0),
            ("kinodynamic.lane_margin_m", self.lane_margin_m, 0.0..=10.0),
            ("kinodynamic.lateral_mps2", self.lateral_mps2, 0.1..=20.0),
            ("kinodynamic.slow_mps", self.slow_mps, 0.1..=100.0),
            ("kinodynamic.brake_mps2", self.brake_mps2, 0.1..=20.0),
            (
                "kinodynamic.goal_distance_m",
                self.goal_distance_m,
                3.0..=100.0,
            ),
            (
                "kinodynamic.goal_heading_rad",
                self.goal_heading_rad,
                0.01..=3.2,
            ),
            ("kinodynamic.goal_sag_m", self.goal_sag_m, 0.01..=1000.0),
            ("kinodynamic.spread_rad", self.spread_rad, 0.0..=3.2),
            ("kinodynamic.reach_m", self.reach_m, 1.0..=100.0),
            ("kinodynamic.uniform_share", self.uniform_share, 0.0..=1.0),
        ];
        for (key, value, range) in rows {
            in_range(key, value, range)?;
        }
        Ok(())
    }
}
