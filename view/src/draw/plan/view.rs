//! Maps the body frame to the picture.

use std::fmt::Write;

use planner::Grid;
use shm_config::message::Plan;
use vehicle::Point;

use crate::draw::canvas::{HEAD_PX, px};

/// Width of the ground in the picture, px.
pub(super) const WIDTH_PX: f64 = 1180.0;
/// Width of the y axis at the left, px.
pub(super) const LEFT_PX: f64 = 84.0;
/// Width of the colour bar at the right, px.
pub(super) const RIGHT_PX: f64 = 150.0;
/// Height of the x axis below, px.
pub(super) const AXIS_PX: f64 = 66.0;
/// Ground behind the car's centre, m: enough for the rear half of the car.
const BEHIND_M: f64 = 3.0;
/// Ground beyond the goal, m.
const BEYOND_M: f64 = 5.0;
/// Minimum ground ahead, m.
const AHEAD_MIN_M: f64 = 15.0;
/// Ground beside the corridor, m.
const BESIDE_M: f64 = 1.5;

/// The visible part of the ground, m, and its place in the picture.
pub(super) struct View {
    pub(super) left_m: f64,
    pub(super) right_m: f64,
    pub(super) x_min_m: f64,
    pub(super) x_max_m: f64,
    pub(super) px_per_m: f64,
}

impl View {
    /// A view that contains car, corridor and goal.
    pub(super) fn of(grid: &Grid, plan: &Plan) -> View {
        let corridor = grid.corridor();
        let far_m = plan
            .waypoints()
            .iter()
            .map(|waypoint| waypoint.x_body_m)
            .fold(plan.goal_x_body_m, f64::max);
        let x_max_m = (far_m + BEYOND_M).max(AHEAD_MIN_M).ceil();
        let x_max_m = x_max_m.min(grid.x_max_m());
        Self {
            left_m: (corridor.left_m + BESIDE_M).ceil().min(grid.y_max_m()),
            right_m: (corridor.right_m - BESIDE_M).floor().max(-grid.y_max_m()),
            x_min_m: -BEHIND_M,
            x_max_m,
            px_per_m: WIDTH_PX / (x_max_m + BEHIND_M),
        }
    }

    /// Position of a point in the picture, px.
    pub(super) fn at(&self, point_body: Point) -> [f64; 2] {
        [
            LEFT_PX + (point_body.x - self.x_min_m) * self.px_per_m,
            HEAD_PX + (self.left_m - point_body.y) * self.px_per_m,
        ]
    }

    /// Height of the ground in the picture, px.
    pub(super) fn height_px(&self) -> f64 {
        (self.left_m - self.right_m) * self.px_per_m
    }

    /// Lower edge of the ground in the picture, px.
    pub(super) fn bottom_px(&self) -> f64 {
        HEAD_PX + self.height_px()
    }

    /// SVG path data of a line through points.
    pub(super) fn data(&self, points_body: &[Point], close: &str) -> String {
        let mut data = String::new();
        for (index, point) in points_body.iter().enumerate() {
            let [x, y] = self.at(*point);
            let letter = if index == 0 { 'M' } else { 'L' };
            // Writing to a string cannot fail.
            let _ = write!(data, "{letter}{} {}", px(x), px(y));
        }
        data + close
    }
}
