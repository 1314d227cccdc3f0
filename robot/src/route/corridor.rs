//! Road and checkpoints from the scan alone: the corridor that a robot without a map is in,
//! such as a hallway.

use shm_config::message::{Observation, Road};
use vehicle::{Point, Pose, pose};

use super::checkpoint;

/// How a corridor is looked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Search {
    /// Half of the width that the robot needs, m: half its own and a margin.
    pub half_width_m: f64,
    /// How far a checkpoint is ahead at most, m.
    pub ahead_m: f64,
    /// A side without a return is as far away as this, m.
    pub side_max_m: f64,
}

/// Greatest angle between the heading and the corridor, rad.
const TURN_MAX_RAD: f64 = 80.0 / 180.0 * std::f64::consts::PI;
/// Angles looked at on each side.
const TURNS: i32 = 40;
/// A way shorter than this many half widths is none.
const WAY_MIN: f64 = 2.0;

/// One straight part of a corridor, in the frame of its beginning.
#[derive(Debug, Clone, Copy)]
struct Way {
    /// Its direction, rad.
    direction_rad: f64,
    /// Free distance along it, m.
    length_m: f64,
    left_m: f64,
    right_m: f64,
}

impl Search {
    /// The freest way from a place: the direction that is free for longest, with a cost for
    /// turns.
    fn way(&self, returns: &[Point], body_from_here: &Pose) -> Way {
        let here: Vec<Point> = returns
            .iter()
            .map(|place| body_from_here.inverse_transform_point(place))
            .collect();
        let step_rad = TURN_MAX_RAD / f64::from(TURNS);
        // From the middle outwards, so that of equal ways the straightest is taken.
        let angles = (0..=TURNS).flat_map(|k| {
            let angle_rad = f64::from(k) * step_rad;
            [angle_rad, -angle_rad]
        });
        // Of two free ways the straighter one, so that the robot does not change between
        // them from tick to tick; of a wall ahead and a long way aside the latter.
        let score = |angle_rad: f64| {
            let length_m = self.free_m(&here, angle_rad);
            (length_m * (angle_rad / 2.0).cos(), length_m)
        };
        let mut best = (f64::NEG_INFINITY, 0.0, 0.0);
        for angle_rad in angles {
            let (worth, length_m) = score(angle_rad);
            if worth > best.0 {
                best = (worth, length_m, angle_rad);
            }
        }
        let (_, length_m, direction_rad) = best;
        let (left_m, right_m) = self.sides_m(&here, direction_rad, length_m);
        Way {
            direction_rad,
            length_m,
            left_m,
            right_m,
        }
    }

    /// How far the robot can go in a direction before a return is in its way, m.
    fn free_m(&self, here: &[Point], direction_rad: f64) -> f64 {
        let turn = nalgebra::Rotation2::new(-direction_rad);
        let in_way = here
            .iter()
            .map(|place| turn * place)
            .filter(|place| place.x > 0.0 && place.y.abs() < self.half_width_m);
        in_way.fold(self.ahead_m, |least_m, place| least_m.min(place.x))
    }

    /// Distances to what is beside the way on its left and right, m.
    fn sides_m(&self, here: &[Point], direction_rad: f64, length_m: f64) -> (f64, f64) {
        let turn = nalgebra::Rotation2::new(-direction_rad);
        let along = -self.half_width_m..=length_m.min(self.ahead_m / 2.0);
        let mut sides_m = (self.side_max_m, self.side_max_m);
        for place in here.iter().map(|place| turn * place) {
            if along.contains(&place.x) {
                match place.y > 0.0 {
                    true => sides_m.0 = sides_m.0.min(place.y),
                    false => sides_m.1 = sides_m.1.min(-place.y),
                }
            }
        }
        sides_m
    }

    /// Fills road and checkpoints of an observation from its scan, in which each pair is the
    /// direction of a beam, rad counter-clockwise from the heading, and its range, m; beams
    /// without a return are left out. Returns whether there is a way on: without one the road
    /// ends in front of the robot.
    ///
    /// A direction without a return counts as free. Ways are looked for up to 80 degrees to
    /// each side of the heading: for a scanner that sees less, the caller adds a return in
    /// each degree of this sector in which no beam looks, a little less than
    /// `2 * half_width_m` away; a way as short as that is none.
    pub fn fill(
        &self,
        observation: &mut Observation,
        scan: impl IntoIterator<Item = (f64, f64)>,
    ) -> bool {
        let place = |(direction_rad, range_m): (f64, f64)| {
            let (sin, cos) = f64::sin_cos(direction_rad);
            Point::new(range_m * cos, range_m * sin)
        };
        let returns: Vec<Point> = scan.into_iter().map(place).collect();
        let first = self.way(&returns, &Pose::identity());
        observation.road = Road {
            left_m: first.left_m,
            right_m: first.right_m,
            heading_rad: -first.direction_rad,
            offset_m: (first.right_m - first.left_m) / 2.0,
            lane_width_m: 0.0,
        };
        let middle_m = (first.left_m - first.right_m) / 2.0;
        let half_m = (first.left_m + first.right_m) / 2.0;
        let body_from_road = pose(0.0, 0.0, first.direction_rad) * pose(0.0, middle_m, 0.0);
        let is_free = first.length_m > WAY_MIN * self.half_width_m;
        // The end of the free way, in the middle of the corridor. A wall across it is the far
        // side of the next corridor, in whose middle the checkpoint is then.
        let back_m = match first.length_m < self.ahead_m {
            true => half_m.min(first.length_m / 2.0),
            false => 0.0,
        };
        let end = body_from_road * Point::new(first.length_m - back_m, 0.0);
        let body_from_end = pose(end.x, end.y, first.direction_rad);
        let second = self.way(&returns, &body_from_end);
        let (sin, cos) = second.direction_rad.sin_cos();
        let far_m = second.length_m / 2.0;
        let beyond = body_from_end * Point::new(far_m * cos, far_m * sin);
        observation.checkpoints = [
            checkpoint(&body_from_road, end, half_m),
            checkpoint(&body_from_end, beyond, half_m),
        ];
        is_free
    }
}
