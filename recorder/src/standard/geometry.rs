//! What a step shows from above, in the body frame of its observation: x forward, y left,
//! m.

use planner::CentreLine;
use shm_config::config::Config;
use shm_config::message::{Observation, Step};
use tracker::{Sighting, Tracker};
use vehicle::{Action, Point, State, Vector, step};

/// The road is drawn from this far behind the car, m.
const ROAD_BEHIND_M: f64 = 12.0;
/// The road is drawn this far ahead at most, m: beyond the lidar's range.
const ROAD_AHEAD_M: f64 = 70.0;
/// Length of one piece of the drawn road, m: in the tightest bend, of 19 m, its chord
/// leaves the edge by 3 cm.
const ROAD_PIECE_M: f64 = 2.0;
/// Two sightings with velocities that differ by less are of one body, m/s.
const SAME_MPS: f64 = 1e-9;

/// The left and the right edge of the road as the planner understands it: along the middle
/// line that edges, heading and checkpoints fix. Empty without a road.
pub fn edges(observation: &Observation) -> [Vec<Point>; 2] {
    let road = &observation.road;
    let half_m = (road.left_m + road.right_m) / 2.0;
    if !(half_m.is_finite() && half_m > 0.0) {
        return [Vec::new(), Vec::new()];
    }
    let line = CentreLine::new(observation);
    let ahead_m = line.known_m().clamp(0.0, ROAD_AHEAD_M);
    let pieces = ((ahead_m + ROAD_BEHIND_M) / ROAD_PIECE_M).ceil() as usize;
    [half_m, -half_m].map(|across_m| {
        let places = (0..=pieces).map(|piece| {
            let along_m = (piece as f64 * ROAD_PIECE_M - ROAD_BEHIND_M).min(ahead_m);
            line.at(along_m).body_from_road * Point::new(0.0, across_m)
        });
        places.collect()
    })
}

/// The path that the safety check assesses when an action is held: the bicycle with the
/// check's step and horizon.
pub fn rollout(config: &Config, action: Action, speed_mps: f64) -> Vec<Point> {
    let (vehicle, limits) = (&config.vehicle, &config.safety);
    let control = action.control(vehicle);
    let steps = (limits.horizon_s / limits.step_s).ceil() as usize;
    let begin = State::at_origin(speed_mps.max(0.0));
    let states = std::iter::successors(Some(begin), |state| {
        Some(step(vehicle, state, control, limits.step_s))
    });
    states.take(steps + 1).map(|state| state.position).collect()
}

/// A body that moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Its middle.
    pub at: Point,
    /// Velocity over ground in the body frame's directions, m/s.
    pub velocity_mps: Vector,
    /// Half the diagonal of its box, m.
    pub radius_m: f64,
}

/// Follows the bodies in successive scans.
#[derive(Debug, Default)]
pub struct Bodies(Tracker);

impl Bodies {
    /// Follows the bodies in a step's scan; a scan that was followed already counts once.
    pub fn follow(&mut self, step: &Step) {
        self.0.follow(&step.observation);
    }

    /// The bodies that move: successive returns with one velocity are of one body.
    pub fn moving(&self) -> impl Iterator<Item = Body> {
        let same =
            |a: &Sighting, b: &Sighting| (a.velocity_body - b.velocity_body).norm() < SAME_MPS;
        let runs = self.0.sightings().chunk_by(same);
        runs.filter(|run| run[0].moves()).map(|run| {
            let sum = run
                .iter()
                .fold(Point::origin(), |sum, one| sum + one.point_body.coords);
            Body {
                at: sum / run.len() as f64,
                velocity_mps: run[0].velocity_body,
                radius_m: run[0].radius_m,
            }
        })
    }
}
