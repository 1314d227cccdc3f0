//! RRT*, and the sizes of its grid and tree.

use serde::{Deserialize, Serialize};

use super::{OutOfRange, in_range};

/// Most cells along x or along y: 100 m of road at 5 cm.
pub const CELLS_MAX: usize = 2048;
/// Largest inflation, cells; a row of the disc then spans at most three words.
pub const DISC_CELLS_MAX: usize = 60;
/// Most nodes of a tree.
pub const NODES_MAX: usize = 4096;

const _: () = assert!(NODES_MAX < u16::MAX as usize, "a node's index is a u16");

/// How the planner makes its plans.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The paper's: RRT* on the occupancy grid of one observation.
    RrtStar,
    /// RRT* that starts from the last path, and samples only where a shorter path is
    /// possible.
    Informed,
    /// RRT* with edges that a car with its turning radius can drive.
    Kinodynamic,
    /// Model-predictive control on the bicycle.
    Mpc,
}

/// The settings of the planner. The defaults are the numbers of Sec. 4.1.1 where the
/// paper gives one; the other fields name their source.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Planner {
    /// The planning method. The rest of this section is about the RRT* methods.
    pub method: Method,
    /// Plans per second: run.rate_hz divided by a whole number, at least 1; 0 for a
    /// plan at every tick. Between plans, the last one is transformed to the car's
    /// present frame.
    pub rate_hz: f64,
    /// Side of a cell, m: the paper's `Δx = Δy`.
    pub cell_m: f64,
    /// The grid reaches from 0 to this far ahead, m: `x_max`.
    pub x_max_m: f64,
    /// The grid reaches this far to either side, m: `y_max`.
    pub y_max_m: f64,
    /// Radius around a lidar return that counts as occupied, m.
    pub inflation_m: f64,
    /// Margin to either edge of the lane corridor, m: `m_lane`. The paper gives no
    /// number. 1.0: half the car's width (0.926 m), so that the whole body stays
    /// inside, and 7 cm for the tracking error.
    pub lane_margin_m: f64,
    /// Samples for each plan; all of them are always drawn.
    pub iterations: u32,
    /// Largest distance of a node from its parent when it is added, m.
    pub step_m: f64,
    /// Radius in which parents are chosen and edges rewired, m: `r*`.
    pub rewire_radius_m: f64,
    /// For rrt-star and informed: with more nodes than this the radius is at most
    /// 2 sqrt(1.5 A / pi) sqrt(ln n / n), m, with n nodes and the area A of the rectangle before
    /// the goal, m²: sqrt(2) times the bound for RRT* (Karaman and Frazzoli, 2011,
    /// doi:10.1177/0278364911406761). The time of a plan then grows less than with the square of
    /// its iterations. The paper's radius is not reduced in its 200 iterations.
    pub shrink_after: u32,
    /// Radius of the goal ball, m: `r_goal`.
    pub goal_radius_m: f64,
    /// Speed at each waypoint, m/s: `v_ref`.
    pub speed_mps: f64,
    /// Share of the samples that are the goal itself. The paper has none: 0.
    #[serde(skip)]
    pub goal_bias: f64,
    /// Largest distance of the goal along the road, m. See the planner's `choose_goal`.
    pub goal_distance_m: f64,
    /// Largest deviation of a bend from the straight line to the goal, m. See the
    /// planner's `choose_goal`.
    #[serde(skip)]
    pub goal_sag_m: f64,
    /// A path that does not reach the goal and ends nearer than this to the car counts
    /// as none, m. 4.0: the front bumper is 2.26 m ahead of the centre, a car at 5 m/s
    /// stops within 1.1 m, and one tick adds 0.5 m. Of another car it follows the
    /// length.
    pub partial_min_m: f64,
    /// Least distance of the goal, m along the road and m ahead of the car's centre: the
    /// lookahead of 2 m and the goal ball of 1 m fit before it. Of a longer car it
    /// follows the length.
    pub goal_near_m: f64,
    /// Seed of the samples. The samples of a plan depend only on it, the episode and
    /// the tick.
    pub seed: u64,
}

impl Default for Planner {
    fn default() -> Self {
        Self {
            method: Method::RrtStar,
            rate_hz: 0.0,
            cell_m: 0.05,
            x_max_m: 30.0,
            y_max_m: 10.0,
            inflation_m: 0.5,
            lane_margin_m: 1.0,
            iterations: 200,
            step_m: 2.0,
            rewire_radius_m: 3.0,
            shrink_after: 200,
            goal_radius_m: 1.0,
            speed_mps: 5.0,
            goal_bias: 0.0,
            goal_distance_m: 15.0,
            goal_sag_m: 0.25,
            partial_min_m: 4.0,
            goal_near_m: 3.0,
            seed: 0,
        }
    }
}

impl Planner {
    /// Checks every number, alone and against the limits of the grid and the tree.
    ///
    /// # Errors
    /// The first number that is not finite or outside its limits.
    pub fn check(&self) -> Result<(), OutOfRange> {
        // All later limits are relative to the cell, so the cell is checked first.
        in_range("planner.cell_m", self.cell_m, 0.01..=1.0)?;
        let cells_m = self.cell_m * CELLS_MAX as f64;
        let disc_m = self.cell_m * DISC_CELLS_MAX as f64;
        let rows = [
            ("planner.x_max_m", self.x_max_m, 5.0..=cells_m),
            ("planner.y_max_m", self.y_max_m, 1.0..=cells_m / 2.0),
            ("planner.inflation_m", self.inflation_m, 0.0..=disc_m),
            ("planner.lane_margin_m", self.lane_margin_m, 0.0..=10.0),
            ("planner.step_m", self.step_m, self.cell_m..=100.0),
            (
                "planner.rewire_radius_m",
                self.rewire_radius_m,
                self.cell_m..=100.0,
            ),
            (
                "planner.goal_radius_m",
                self.goal_radius_m,
                self.cell_m..=100.0,
            ),
            ("planner.speed_mps", self.speed_mps, 0.0..=100.0),
            ("planner.goal_bias", self.goal_bias, 0.0..=1.0),
            (
                "planner.goal_distance_m",
                self.goal_distance_m,
                3.0..=1000.0,
            ),
            ("planner.goal_sag_m", self.goal_sag_m, 0.01..=1000.0),
            ("planner.partial_min_m", self.partial_min_m, 0.0..=100.0),
            (
                "planner.goal_near_m",
                self.goal_near_m,
                0.1..=self.x_max_m - 2.0 * self.cell_m,
            ),
        ];
        for (key, value, range) in rows {
            in_range(key, value, range)?;
        }
        // The square root falls from the third node on.
        in_range(
            "planner.shrink_after",
            self.shrink_after,
            3..=NODES_MAX as u32,
        )?;
        in_range(
            "planner.iterations",
            self.iterations,
            1..=NODES_MAX as u32 - 1,
        )
    }
}
