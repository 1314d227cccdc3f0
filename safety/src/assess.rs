use shm_config::message::{Assessment, BEAMS_MAX, Observation, Verdict};
use shm_config::settings::SafetyLimits;
#[allow(unused_imports)]
use vehicle::Float as _;
use vehicle::{Action, Point, Sight, State, Vehicle, step};

use crate::RoadAhead;

/// Clearance reported when nothing is near, m.
pub const CLEARANCE_MAX_M: f64 = 50.0;

/// How far a body's corner may lie beyond the road's edge, m: the sidewalk
/// begins 0.2 m outside it.
const SIDEWALK_M: f64 = 0.2;

/// Below this speed, m/s, a car that is nearer to something than the margin may drive on.
const CREEP_MPS: f64 = 1.0;
/// By as much less, m, it is as near as before.
const NEARER_M: f64 = 1e-3;

/// What proposals are judged against: the lidar's returns and the road, in the
/// body frame. Made once a tick, without allocation.
pub struct Scene {
    returns_body: heapless::Vec<Point, BEAMS_MAX>,
    sight: Sight,
    /// The farthest place from the scanner that a rollout reaches, m.
    reach_m: f64,
    road: RoadAhead,
    checkpoint_body: Point,
    speed_mps: f64,
}

impl Scene {
    /// The scene of an admitted observation. Returns beyond `reach_m` of the car
    /// are left out: no rollout gets there.
    pub fn new(observation: &Observation, reach_m: f64) -> Self {
        let fan = observation.fan();
        let checkpoint = &observation.checkpoints[0];
        // Filled in place: room for 2,048 returns has 32 kB, which a move would copy.
        let mut scene = Self {
            returns_body: heapless::Vec::new(),
            sight: fan.sight(),
            // The argument is from the body's centre, the ranges are from the scanner.
            reach_m: reach_m + fan.mount_body.coords.norm(),
            road: RoadAhead::new(observation),
            checkpoint_body: Point::new(checkpoint.x_body_m, checkpoint.y_body_m),
            speed_mps: observation.ego.speed_mps.max(0.0),
        };
        let limit_m = observation.lidar_max_m.min(scene.reach_m as f32);
        for (beam, &range_m) in observation.ranges().iter().enumerate() {
            if range_m < limit_m {
                // Cannot overflow: there is one place for each beam.
                let point_body = fan.point_body(beam, f64::from(range_m));
                let _ = scene.returns_body.push(point_body);
            }
        }
        scene
    }

    /// The farthest that a car can get within the horizon, m, footprint and margin
    /// included.
    pub fn reach_m(vehicle: &Vehicle, limits: &SafetyLimits, speed_mps: f64) -> f64 {
        let speed_mps = speed_mps.max(0.0);
        let travel_m = speed_mps * limits.horizon_s
            + 0.5 * vehicle.max_accel_mps2 * limits.horizon_s * limits.horizon_s;
        travel_m + vehicle.footprint().radius_m() + limits.margin_m + 1.0
    }
}

/// Rolls a proposal out, held for the whole horizon, and measures it.
///
/// The rollout is the bicycle of Eq. 3 to 6 with the accurate step; the paper's
/// single step of 1.5 s is used in its picture only. Obstacles are the lidar
/// returns at rest. The proposal is vetoed when it would touch something, or
/// leave the road, sooner than the brake could still prevent it. The car's delay counts
/// as time that the brake needs.
///
/// A car that creeps, and is nearer to something than the margin, only has to come no
/// nearer: one that was stopped beside an obstacle would stand there for ever otherwise.
///
/// Space at which no beam looks counts as occupied where the front of the body would
/// enter it, since nothing says that it is free. The sides and the rear are not checked:
/// the car does not reverse, so they follow where the front has been. In a scan without
/// beams all space is unseen, so the car stands.
pub fn assess(
    vehicle: &Vehicle,
    limits: &SafetyLimits,
    scene: &Scene,
    proposal: Option<Action>,
) -> Assessment {
    let Some(action) = proposal else {
        return Assessment {
            verdict: Verdict::Absent.code(),
            ..Assessment::default()
        };
    };
    let control = action.control(vehicle);
    let steps = (limits.horizon_s / limits.step_s).ceil() as u32;
    let mut state = State::at_origin(scene.speed_mps);
    // The car's present position is not part of a proposal: only later states count.
    let edge_now_m = edge_m(vehicle, scene, &state);
    let clearance_now_m = clearance_m(vehicle, scene, &state);
    let creeps = scene.speed_mps < CREEP_MPS && clearance_now_m < limits.margin_m;
    let least_m = match creeps {
        true => (clearance_now_m - NEARER_M).max(0.0),
        false => limits.margin_m,
    };
    let mut measured = Assessment {
        clearance_m: clearance_now_m,
        safe_s: limits.horizon_s,
        edge_m: edge_now_m,
        verdict: Verdict::Clear.code(),
        ..Assessment::default()
    };
    for k in 1..=steps {
        state = step(vehicle, &state, control, limits.step_s);
        let (clearance_m, edge_m) = (
            clearance_m(vehicle, scene, &state),
            edge_m(vehicle, scene, &state),
        );
        measured.clearance_m = measured.clearance_m.min(clearance_m);
        measured.edge_m = measured.edge_m.min(edge_m);
        let enters_unseen = || state.speed_mps > 0.0 && is_front_unseen(vehicle, scene, &state);
        let found = if clearance_m < least_m && state.speed_mps > 0.0 || enters_unseen() {
            Verdict::Hits
        } else if edge_m < (limits.edge_margin_m - SIDEWALK_M).min(edge_now_m) {
            Verdict::Leaves
        } else {
            continue;
        };
        measured.verdict = found.code();
        measured.safe_s = f64::from(k) * limits.step_s;
        break;
    }
    let to_checkpoint_m = |point: Point| (scene.checkpoint_body - point).norm();
    measured.progress_m = to_checkpoint_m(Point::origin()) - to_checkpoint_m(state.position);
    let stopping_s =
        scene.speed_mps / vehicle.max_brake_mps2 + limits.reaction_s + vehicle.delay_s();
    let doomed = measured.verdict() != Verdict::Clear && measured.safe_s <= stopping_s;
    measured.veto = u32::from(doomed);
    measured
}

/// Least distance from the footprint to a return, m; negative inside.
fn clearance_m(vehicle: &Vehicle, scene: &Scene, state: &State) -> f64 {
    let footprint = vehicle.footprint();
    let body_from_world = state.pose().inverse();
    scene
        .returns_body
        .iter()
        .map(|point| footprint.distance_m(body_from_world * point))
        .fold(CLEARANCE_MAX_M, f64::min)
}

/// Places of the front edge that have to be seen: the corners and three between them, so
/// that no wedge hides between the corners.
const FRONT_SHARES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

/// Whether a part of the front edge is where no beam looks and the car does not stand now.
fn is_front_unseen(vehicle: &Vehicle, scene: &Scene, state: &State) -> bool {
    let footprint = vehicle.footprint();
    let width_m = footprint.width_m;
    if scene.sight.covers_all(scene.reach_m, width_m) {
        return false;
    }
    let [front_left, _, _, front_right] = footprint.corners(&state.pose());
    FRONT_SHARES
        .into_iter()
        .map(|share| front_left + (front_right - front_left) * share)
        .any(|place| footprint.distance_m(place) > 0.0 && !scene.sight.covers(place, width_m))
}

/// Least distance from a corner of the footprint to the road's edge, m.
fn edge_m(vehicle: &Vehicle, scene: &Scene, state: &State) -> f64 {
    vehicle
        .footprint()
        .corners(&state.pose())
        .into_iter()
        .map(|corner_body| scene.road.edge_m(corner_body))
        .fold(f64::INFINITY, f64::min)
}
