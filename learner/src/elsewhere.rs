//! The observation from another pose near the car.
//!
//! The expert is asked at predicted states of a rollout as if the car were there: the
//! lidar returns, the road and the checkpoints of the observation are transformed to
//! the other pose. What was hidden stays unknown, and moving bodies stay where they
//! were, which is a good approximation for the second or two of a rollout.

use shm_config::message::{BEAMS_MAX, Bend, Observation};
use vehicle::{Fan, Point, Pose, State, wrap_rad};

/// Neighbouring returns nearer to each other than this belong to one body, m: a car
/// could not pass between them.
const JOINED_M: f64 = 1.5;
/// A bend with a smaller radius is too tight for any car, m.
const CENTRE_MIN_M: f64 = 1.0;

/// Writes the observation after a motion. `moved` is the car's state in the body frame
/// of `from`, its speed in m/s, and the action it last applied.
pub fn observe(
    from: &Observation,
    moved: &State,
    (steer, pedal): (f64, f64),
    out: &mut Observation,
) {
    *out = *from;
    let body_from_there = moved.pose();
    let there_from_body = body_from_there.inverse();
    move_ego(from, moved, out);
    (out.ego.steer, out.ego.pedal) = (steer, pedal);
    move_road(from, &body_from_there, out);
    for checkpoint in &mut out.checkpoints {
        let point = there_from_body * Point::new(checkpoint.x_body_m, checkpoint.y_body_m);
        (checkpoint.x_body_m, checkpoint.y_body_m) = (point.x, point.y);
    }
    scan(from, &there_from_body, out);
}

fn move_ego(from: &Observation, moved: &State, out: &mut Observation) {
    let ego = &from.ego;
    let world_from_body = vehicle::pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad);
    let position_world = world_from_body * moved.position;
    out.ego.x_world_m = position_world.x;
    out.ego.y_world_m = position_world.y;
    out.ego.heading_world_rad = wrap_rad(ego.heading_world_rad + moved.heading_rad);
    out.ego.speed_mps = moved.speed_mps;
}

/// The edges of the road as two lines, or as two arcs around one centre.
fn move_road(from: &Observation, body_from_there: &Pose, out: &mut Observation) {
    let road = &from.road;
    let checkpoint = &from.checkpoints[0];
    let to_leftmost_m = road.left_m - road.lane_width_m / 2.0;
    let centre_y_m = match checkpoint.bend() {
        Bend::Straight => f64::INFINITY,
        Bend::Left => to_leftmost_m + checkpoint.bend_radius_m,
        Bend::Right => to_leftmost_m - checkpoint.bend_radius_m,
    };
    let place_road =
        vehicle::pose(0.0, 0.0, road.heading_rad) * Point::from(body_from_there.translation.vector);
    let (offset_m, turned_rad) = match centre_y_m.is_finite() && centre_y_m.abs() > CENTRE_MIN_M {
        false => (place_road.y, 0.0),
        true => {
            let across_m = centre_y_m - place_road.y;
            let radius_m = place_road.x.hypot(across_m);
            let offset_m = (centre_y_m.abs() - radius_m) * centre_y_m.signum();
            let turned_rad = place_road.x.atan2(across_m.abs()) * centre_y_m.signum();
            (offset_m, turned_rad)
        }
    };
    out.road.left_m = road.left_m - offset_m;
    out.road.right_m = road.right_m + offset_m;
    out.road.offset_m = road.offset_m + offset_m;
    let heading_rad = road.heading_rad + body_from_there.rotation.angle() - turned_rad;
    out.road.heading_rad = wrap_rad(heading_rad);
}

/// The scan from the other pose: joined neighbours become segments; a single return
/// becomes a segment as wide as the gap between two beams.
fn scan(from: &Observation, there_from_body: &Pose, out: &mut Observation) {
    let ranges_m = from.ranges();
    let beams = ranges_m.len();
    if beams == 0 {
        return;
    }
    let fan = from.fan();
    let max_m = f64::from(from.lidar_max_m);
    out.ranges_m[..beams].fill(from.lidar_max_m);
    let mut points = [None; BEAMS_MAX];
    for (k, &range_m) in ranges_m.iter().enumerate() {
        let range_m = f64::from(range_m);
        if range_m < max_m {
            points[k] = Some(there_from_body * fan.point_body(k, range_m));
        }
    }
    for k in 0..beams {
        let Some(point) = points[k] else {
            continue;
        };
        // The last beam of a partial scan has no neighbour.
        let next = match k + 1 < beams || fan.is_circle() {
            true => points[(k + 1) % beams],
            false => None,
        };
        let next = next.filter(|next| (next - point).norm() < JOINED_M);
        fill(
            point,
            next.unwrap_or(point),
            &fan,
            &mut out.ranges_m[..beams],
            max_m,
        );
    }
}

/// Shortens the beams that hit the segment.
fn fill(a: Point, b: Point, fan: &Fan, ranges_m: &mut [f32], max_m: f64) {
    // As the scanner sees it.
    let from_mount = |point: Point| Point::from(point - fan.mount_body);
    let (a, b) = (from_mount(a), from_mount(b));
    let (from_rad, to_rad) = (a.y.atan2(a.x), b.y.atan2(b.x));
    let sweep_rad = wrap_rad(to_rad - from_rad);
    // The segment is extended by half a gap at both ends, so that no body falls between
    // two beams.
    let (low_rad, high_rad) = match sweep_rad < 0.0 {
        true => (from_rad + sweep_rad, from_rad),
        false => (from_rad, from_rad + sweep_rad),
    };
    let first_beam = fan.beam_at(low_rad);
    let first = (first_beam - 0.5).ceil() as i64;
    let last = (first_beam + (high_rad - low_rad) / fan.spacing_rad() + 0.5).floor() as i64;
    let along = b - a;
    let beams = ranges_m.len() as i64;
    for k in first..=last {
        let k = match fan.is_circle() {
            true => k.rem_euclid(beams) as usize,
            // No beam looks there.
            false if !(0..beams).contains(&k) => continue,
            false => k as usize,
        };
        let (sin, cos) = fan.angle_rad(k).sin_cos();
        // The beam crosses the segment's line at this share of its length.
        let across = cos * along.y - sin * along.x;
        let share = match across.abs() > 1e-9 {
            true => ((sin * a.x - cos * a.y) / across).clamp(0.0, 1.0),
            false => 0.0,
        };
        let meets = a + along * share;
        let range_m = meets.coords.norm().min(max_m) as f32;
        let beam = &mut ranges_m[k];
        *beam = beam.min(range_m);
    }
}

/// Adds a body to the observation: its outline shortens the beams that hit it.
pub fn place(outline_body: &[Point], observation: &mut Observation) {
    let beams = observation.ranges().len();
    if beams == 0 {
        return;
    }
    let max_m = f64::from(observation.lidar_max_m);
    let fan = observation.fan();
    let ranges_m = &mut observation.ranges_m[..beams];
    for (k, &corner) in outline_body.iter().enumerate() {
        let next = outline_body[(k + 1) % outline_body.len()];
        fill(corner, next, &fan, ranges_m, max_m);
    }
}
