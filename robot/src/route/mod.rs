//! Road and checkpoints of an observation, where the robot's own sensors do not give them:
//! from a map and a pose ([`Route`]), or from the scan alone ([`corridor`]).
//!
//! An observation needs both at its own instant. So they are made by the process that
//! publishes it, and not by one beside it, whose answer would have an age of its own.

pub mod commonroad;
pub mod corridor;
mod error;
pub mod lanelet2;
mod lanelets;
mod line;
mod table;

pub use error::RouteError;
pub use line::{Located, ROWS_MAX, Route, Row};

use shm_config::message::{Bend, Checkpoint};
use vehicle::{Point, Pose};

/// A checkpoint at a place, m, in the frame of the body; the middle line of the road goes
/// there along an arc from a place and direction of that frame. The left edge is `left_m`
/// from the middle line; its radius is the bend's, as it is of a road without lanes.
fn checkpoint(body_from_start: &Pose, place_body: Point, left_m: f64) -> Checkpoint {
    let end = body_from_start.inverse_transform_point(&place_body);
    let (x, y) = (end.x, end.y);
    // Half the turn of an arc is the angle between its chord and its beginning.
    let turn_rad: f64 = 2.0 * y.atan2(x);
    let is_straight = turn_rad.abs() < STRAIGHT_RAD;
    let (bend, radius_m, angle_rad) = match is_straight {
        true => (Bend::Straight, 0.0, 0.0),
        false => {
            let middle_m = (x * x + y * y) / (2.0 * y.abs());
            let (bend, edge_m) = match y > 0.0 {
                true => (Bend::Left, middle_m - left_m),
                false => (Bend::Right, middle_m + left_m),
            };
            (bend, edge_m.max(RADIUS_MIN_M), turn_rad.abs())
        }
    };
    Checkpoint {
        x_body_m: place_body.x,
        y_body_m: place_body.y,
        bend_radius_m: radius_m,
        bend_angle_rad: angle_rad,
        bend: bend.code(),
        reserved: 0,
    }
}

/// Roads that turn by less are straight, rad.
const STRAIGHT_RAD: f64 = 0.02;
/// A bend whose inner edge is a corner has this radius, m.
const RADIUS_MIN_M: f64 = 0.1;
