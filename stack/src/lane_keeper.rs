//! A simple lane keeper, which sees the observation alone.

use shm_config::message::{Bend, Observation};
use vehicle::Action;

/// Speed of the lane keeper on a straight road, m/s.
const CRUISE_MPS: f64 = 8.0;
/// Sideways acceleration it takes a bend with, m/s².
const SIDEWAYS_MPS2: f64 = 3.0;
/// A bend counts from this far before its road, m.
const BEND_AHEAD_M: f64 = 12.0;
/// Half the width of the strip ahead in which it brakes for what it sees, m.
const STRIP_M: f64 = 1.3;
/// It stops this far behind an obstacle, from centre to return, m.
const STANDOFF_M: f64 = 5.0;
/// The deceleration that it assumes, m/s².
const BRAKE_MPS2: f64 = 3.0;

/// Keeps to its lane, slows down for bends and for what is straight ahead, and
/// never changes lanes. It sees the observation alone, so it drives in any
/// world that publishes one.
pub fn keep_lane(observation: &Observation) -> Action {
    let road = &observation.road;
    let mut speed_mps = CRUISE_MPS;
    let [here, next] = &observation.checkpoints;
    let to_next_m = here.x_body_m.hypot(here.y_body_m);
    for (checkpoint, near) in [(here, true), (next, to_next_m < BEND_AHEAD_M)] {
        if near && checkpoint.bend != Bend::Straight.code() {
            let bend_mps = (SIDEWAYS_MPS2 * checkpoint.bend_radius_m).sqrt();
            speed_mps = speed_mps.min(bend_mps);
        }
    }
    let room_m = (free_ahead_m(observation) - STANDOFF_M).max(0.0);
    speed_mps = speed_mps.min((2.0 * BRAKE_MPS2 * room_m).sqrt());
    Action {
        steer: -(0.8 * road.heading_rad + 0.12 * road.offset_m),
        pedal: 0.3 * (speed_mps - observation.ego.speed_mps),
    }
    .clamped()
}

/// Distance to the nearest return in the strip ahead, m; infinite when free.
fn free_ahead_m(observation: &Observation) -> f64 {
    let fan = observation.fan();
    let ranges_m = observation.ranges();
    let returns = ranges_m.iter().enumerate().filter_map(|(k, &range_m)| {
        if range_m >= observation.lidar_max_m {
            return None;
        }
        let point_body = fan.point_body(k, f64::from(range_m));
        (point_body.x > 0.0 && point_body.y.abs() < STRIP_M).then_some(point_body.x)
    });
    returns.fold(f64::INFINITY, f64::min)
}
