use vehicle::{Point, Pose, pose};

use super::body::Body;
use crate::centre_line::CentreLine;
use crate::grid::Grid;

/// The nearest goal, m along the road: the front bumper is 2.3 m ahead.
const NEAR_M: f64 = 3.0;
/// Distance between the places looked at, m, along the road and across it.
const APART_M: f64 = 0.5;

/// Where the car is to be, and in which direction: on the middle line of the
/// road, at most so far along, in the direction of the road there.
///
/// While the middle line itself is free, the goal is on it, and in a bend no
/// farther than the bend leaves the straight line to it by `sag_m`: the shortest
/// path to a goal far round a bend follows the inner edge, and cuts into the path of other
/// cars. With an obstacle on the line, the goal is behind it, as far as allowed.
///
/// Then it is the farthest place along the line where the car could stand, and of those
/// across the road there the one nearest to the middle line; of two as near the
/// one on the side where the car is. The path there is not checked: the tree finds it.
/// Without any such place, the goal is straight ahead on the road, at the least
/// distance.
///
/// Returns the pose and how far along the line it is, m.
pub(super) fn choose_goal(
    grid: &Grid,
    body: &Body,
    line: &CentreLine,
    (most_m, sag_m): (f64, f64),
) -> (Pose, f64) {
    let end_m = most_m.min(line.known_m()).max(NEAR_M);
    let end_m = match is_line_free(grid, body, line, end_m) {
        true => until_sag(line, end_m, sag_m),
        false => end_m,
    };
    let beside_m = line
        .at(0.0)
        .body_from_road
        .inverse_transform_point(&Point::origin())
        .y;
    let side = if beside_m < 0.0 { -1.0 } else { 1.0 };
    let steps = ((end_m - NEAR_M) / APART_M) as usize;
    let across = (2.0 * grid.y_max_m() / APART_M) as usize;
    (0..=steps)
        .map(|step| end_m - step as f64 * APART_M)
        .find_map(|along_m| {
            let road = line.at(along_m).body_from_road;
            (0..=across)
                .map(|index| {
                    let step = index.div_ceil(2) as f64 * APART_M * side;
                    let across_m = if index % 2 == 1 { step } else { -step };
                    road * pose(0.0, across_m, 0.0)
                })
                .find(|goal| is_finite(goal) && body.is_free_at(grid, goal))
                .map(|goal| (goal, along_m))
        })
        .unwrap_or_else(|| {
            let near = line.at(NEAR_M).body_from_road;
            match is_finite(&near) {
                true => (near, NEAR_M),
                false => (pose(NEAR_M, 0.0, 0.0), NEAR_M),
            }
        })
}

/// Whether the car could drive along the middle line itself, m.
fn is_line_free(grid: &Grid, body: &Body, line: &CentreLine, end_m: f64) -> bool {
    (0..=((end_m - NEAR_M) / APART_M) as usize)
        .map(|step| line.at(NEAR_M + step as f64 * APART_M).body_from_road)
        .all(|place| is_finite(&place) && body.is_free_at(grid, &place))
}

/// How far along the line it leaves its chord by no more than so much, m.
fn until_sag(line: &CentreLine, end_m: f64, sag_m: f64) -> f64 {
    (0..=((end_m - NEAR_M) / APART_M) as usize)
        .map(|step| end_m - step as f64 * APART_M)
        // The height of an arc over its chord is length * turn / 8.
        .find(|&along_m| along_m * line.at(along_m).turn_rad.abs() / 8.0 <= sag_m)
        .unwrap_or(NEAR_M)
}

fn is_finite(pose: &Pose) -> bool {
    pose.translation.vector.norm().is_finite() && pose.rotation.re.is_finite()
}
