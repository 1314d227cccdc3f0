use shm_config::message::Observation;
use vehicle::Point;

use crate::PlannerConfig;
use crate::centre_line::CentreLine;
use crate::corridor::Corridor;
use crate::grid::Grid;

/// Distance between the places looked at along the road, m.
const ALONG_M: f64 = 0.5;
/// Distance between the places looked at across the road, m; half the radius of
/// the goal ball.
const ACROSS_M: f64 = 0.5;

/// The local goal of Sec. 4.1.1, m.
///
/// The paper takes the next checkpoint, and does not say what happens when it is
/// outside the grid, behind a bend, or occupied. Here the goal is on the middle
/// line of the road, which ends in the checkpoint, at its end if possible:
///
/// 1. The line runs from beside the car to checkpoint 1 and on to checkpoint 2;
///    a checkpoint that has been passed is left out.
/// 2. The goal is the farthest point of it, at most `goal_distance_m` along, up
///    to which the line stays inside the grid and the corridor, and leaves the
///    straight line to it by at most `goal_sag_m`. Within a bend this brings the
///    goal nearer: the corridor is straight and the car is drawn straight to the
///    goal, so a goal far round the bend would lead across its inner edge.
/// 3. If that point is occupied or hidden, the nearest point across the road
///    that the car sees, with no occupied cell between; then the nearest one that is
///    only free; then the same at places nearer to the car, half a metre at a time.
///    If all are occupied, the goal stays where rule 2 put it.
///
/// Because the goal is visible, the car's position decides on which side an obstacle is
/// passed, so that the planner, which has no memory, chooses the same side at each tick.
///
/// `grid` shows the same observation. The goal is inside the grid and the lane
/// corridor, and at least `goal_near_m` ahead.
pub fn choose_goal(grid: &Grid, config: &PlannerConfig, observation: &Observation) -> Point {
    let lane = Corridor::lane(&observation.road, config.lane_margin_m, grid.y_max_m());
    let line = CentreLine::new(observation);
    let across = |distance_m: f64| {
        let body_from_road = line.at(distance_m).body_from_road;
        offsets(&lane)
            .map(move |across_m| body_from_road * Point::new(0.0, across_m))
            .map(move |place_body| limited(grid, config, &lane, place_body))
    };
    let farthest_m = farthest(grid, config, &lane, &line);
    let free = |place_body: &Point| {
        grid.cell_at(*place_body)
            .is_some_and(|cell| !grid.is_occupied(cell))
    };
    let in_view = |place_body: &Point| grid.is_segment_free(Point::origin(), *place_body);
    if let Some(place_body) = across(farthest_m).find(in_view) {
        return place_body;
    }
    let nearer = (farthest_m - config.goal_near_m) / ALONG_M;
    (0..=nearer.max(0.0) as usize)
        .map(|step| farthest_m - step as f64 * ALONG_M)
        .flat_map(across)
        .find(free)
        .unwrap_or(limited(
            grid,
            config,
            &lane,
            line.at(farthest_m).body_from_road * Point::origin(),
        ))
}

/// How far along the line the goal may be, m: rule 2.
fn farthest(grid: &Grid, config: &PlannerConfig, lane: &Corridor, line: &CentreLine) -> f64 {
    let end_m = config.goal_distance_m.min(line.length_m());
    let good = |distance_m: &f64| {
        let station = line.at(*distance_m);
        let Point { coords: place } = station.body_from_road.translation.vector.into();
        // The height of an arc over its chord is length * turn / 8.
        let sag_m = distance_m * station.turn_rad.abs() / 8.0;
        place.x <= grid.x_max_m()
            && (lane.right_m..=lane.left_m).contains(&place.y)
            && sag_m <= config.goal_sag_m
    };
    let near_m = config.goal_near_m;
    let steps = ((end_m - near_m) / ALONG_M).max(0.0) as usize;
    (0..=steps)
        .map(|step| near_m + step as f64 * ALONG_M)
        .take_while(good)
        .last()
        .unwrap_or(near_m)
}

/// Offsets across the road, m: 0, then either side, outwards, as far as the
/// corridor is wide.
fn offsets(lane: &Corridor) -> impl Iterator<Item = f64> + use<> {
    let steps = ((lane.left_m - lane.right_m) / ACROSS_M).max(0.0) as usize;
    (0..=2 * steps).map(|index| {
        let step = index.div_ceil(2) as f64;
        if index % 2 == 1 {
            step * ACROSS_M
        } else {
            -step * ACROSS_M
        }
    })
}

/// The place moved into the lane corridor and the part of the grid that is far
/// enough ahead.
fn limited(grid: &Grid, config: &PlannerConfig, lane: &Corridor, place_body: Point) -> Point {
    let near_m = config.goal_near_m;
    Point::new(
        place_body.x.clamp(near_m, grid.x_max_m() - grid.cell_m()),
        place_body.y.clamp(lane.right_m, lane.left_m),
    )
}
