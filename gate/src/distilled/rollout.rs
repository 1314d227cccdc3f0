use safety::{CLEARANCE_MAX_M, RoadAhead};
use shm_config::message::Observation;
use vehicle::{Action, Point, State, Vehicle, step};

/// How long a proposal is held, s: as long as the record of a judge looks ahead.
pub const HORIZON_S: f64 = 3.0;
/// Step of the rollout, s.
const STEP_S: f64 = 0.1;
/// Steps of the rollout.
const STEPS: usize = 30;
/// Windows of the rollout, each of [`STEPS`] / [`WINDOWS`] steps.
pub const WINDOWS: usize = 10;
/// A rollout that comes nearer to a return touches it, m.
const TOUCH_M: f64 = 0.1;

/// What a rollout comes near to, measured against the lidar's returns at rest and the
/// road's edges.
pub struct Course {
    /// Least distance to a return in each window, m; negative inside.
    pub clearance_m: [f64; WINDOWS],
    /// Least distance to the road's edge in each window, m; negative beyond it.
    pub edge_m: [f64; WINDOWS],
    /// Time to the first touch, s; the horizon if there is none.
    pub touch_s: f64,
    /// Time to the first corner beyond the edge, s; the horizon if there is none.
    pub out_s: f64,
    /// When the nearest return is nearest, s.
    pub nearest_s: f64,
    /// The nearest return, seen from the car at that instant, m.
    pub nearest: Point,
    /// Progress towards the next checkpoint, m.
    pub progress_m: f64,
    /// Distance driven, m.
    pub driven_m: f64,
    /// Speed at the end, m/s.
    pub speed_mps: f64,
}

/// The returns of a scan and the road, in the body frame.
pub struct Surroundings {
    returns: Vec<Point>,
    road: RoadAhead,
    checkpoint: Point,
    speed_mps: f64,
}

impl Surroundings {
    /// Those of an observation.
    pub fn new(observation: &Observation) -> Self {
        let fan = observation.fan();
        let limit_m = observation.lidar_max_m;
        let ranges = observation.ranges().iter().enumerate();
        let returns = ranges.filter(|(_, range_m)| **range_m < limit_m);
        let checkpoint = &observation.checkpoints[0];
        Self {
            returns: returns
                .map(|(beam, range_m)| fan.point_body(beam, f64::from(*range_m)))
                .collect(),
            road: RoadAhead::new(observation),
            checkpoint: Point::new(checkpoint.x_body_m, checkpoint.y_body_m),
            speed_mps: observation.ego.speed_mps.max(0.0),
        }
    }

    /// Holds an action for the whole horizon.
    pub fn course(&self, vehicle: &Vehicle, action: Action) -> Course {
        let footprint = vehicle.footprint();
        let control = action.control(vehicle);
        let mut state = State::at_origin(self.speed_mps);
        let mut course = Course {
            clearance_m: [CLEARANCE_MAX_M; WINDOWS],
            edge_m: [CLEARANCE_MAX_M; WINDOWS],
            touch_s: HORIZON_S,
            out_s: HORIZON_S,
            nearest_s: HORIZON_S,
            nearest: Point::new(CLEARANCE_MAX_M, 0.0),
            progress_m: 0.0,
            driven_m: 0.0,
            speed_mps: 0.0,
        };
        let mut least_m = CLEARANCE_MAX_M;
        for k in 0..STEPS {
            let before = state.position;
            state = step(vehicle, &state, control, STEP_S);
            course.driven_m += (state.position - before).norm();
            let now_s = (k + 1) as f64 * STEP_S;
            let window = k * WINDOWS / STEPS;
            let pose = state.pose();
            let corners = footprint.corners(&pose);
            let edges = corners.iter().map(|corner| self.road.edge_m(*corner));
            let edge_m = edges.fold(f64::INFINITY, f64::min);
            let body_from_world = pose.inverse();
            for point in &self.returns {
                let seen = body_from_world * point;
                let distance_m = footprint.distance_m(seen);
                let in_window = &mut course.clearance_m[window];
                *in_window = in_window.min(distance_m);
                if distance_m < least_m {
                    least_m = distance_m;
                    (course.nearest_s, course.nearest) = (now_s, seen);
                }
            }
            course.edge_m[window] = course.edge_m[window].min(edge_m);
            if course.clearance_m[window] < TOUCH_M {
                course.touch_s = course.touch_s.min(now_s);
            }
            if edge_m < 0.0 {
                course.out_s = course.out_s.min(now_s);
            }
        }
        let to_checkpoint_m = |point: Point| (self.checkpoint - point).norm();
        course.progress_m = to_checkpoint_m(Point::origin()) - to_checkpoint_m(state.position);
        course.speed_mps = state.speed_mps;
        course
    }
}
