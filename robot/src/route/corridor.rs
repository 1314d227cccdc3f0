//! Road and checkpoints from the scan alone: the corridor that a robot without a map is in,
//! such as a hallway.

use std::ops::Range;

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
/// Directions looked at on each side of the heading, and all of them.
const TURNS: usize = 40;
const DIRECTIONS: usize = 2 * TURNS + 1;
/// Angle between two of them, rad.
const STEP_RAD: f64 = TURN_MAX_RAD / TURNS as f64;
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

/// A direction that is looked at, rad from the heading.
fn direction_rad(index: usize) -> f64 {
    (index as f64 - TURNS as f64) * STEP_RAD
}

impl Search {
    /// The freest way from a place: the direction that is free for longest, with a cost for
    /// turns.
    fn way(&self, returns: impl Iterator<Item = Point> + Clone, body_from_here: &Pose) -> Way {
        let here = returns.map(|place| body_from_here.inverse_transform_point(&place));
        let free_m = self.free_m(here.clone());
        // From the middle outwards, so that of equal ways the straightest is taken.
        let outwards = (0..=TURNS).flat_map(|turn| [TURNS + turn, TURNS - turn]);
        // Of two free ways the straighter one, so that the robot does not change between
        // them from tick to tick; of a wall ahead and a long way aside the latter.
        let score = |angle_rad: f64, length_m: f64| length_m * (angle_rad / 2.0).cos();
        let mut best = (f64::NEG_INFINITY, 0.0, 0.0);
        for index in outwards {
            let (angle_rad, length_m) = (direction_rad(index), free_m[index]);
            let worth = score(angle_rad, length_m);
            if worth > best.0 {
                best = (worth, length_m, angle_rad);
            }
        }
        let (_, length_m, direction_rad) = best;
        let (left_m, right_m) = self.sides_m(here, direction_rad, length_m);
        Way {
            direction_rad,
            length_m,
            left_m,
            right_m,
        }
    }

    /// How far the robot can go in each direction before a return is in its way, m.
    fn free_m(&self, here: impl Iterator<Item = Point>) -> [f64; DIRECTIONS] {
        let turns: [_; DIRECTIONS] =
            std::array::from_fn(|index| nalgebra::Rotation2::new(-direction_rad(index)));
        let mut free_m = [self.ahead_m; DIRECTIONS];
        for place in here {
            for index in self.hindered(place) {
                let turned = turns[index] * place;
                if turned.x > 0.0 && turned.y.abs() < self.half_width_m {
                    free_m[index] = free_m[index].min(turned.x);
                }
            }
        }
        free_m
    }

    /// The directions in which a return may be in the way, one more on either side: those
    /// within the angle that half of the robot's width has at its distance.
    fn hindered(&self, place: Point) -> Range<usize> {
        let away_m = place.coords.norm();
        if away_m > self.ahead_m.hypot(self.half_width_m) {
            return 0..0;
        }
        let middle_rad = place.y.atan2(place.x) + TURN_MAX_RAD;
        // Of a return nearer than half the width, a quarter of a turn.
        let half_rad = (self.half_width_m / away_m).min(1.0).asin();
        let first = (middle_rad - half_rad) / STEP_RAD - 1.0;
        let last = (middle_rad + half_rad) / STEP_RAD + 1.0;
        // The conversion of what is below 0 saturates.
        first as usize..(last.max(-1.0) + 1.0).min(DIRECTIONS as f64) as usize
    }

    /// Distances to what is beside the way on its left and right, m.
    fn sides_m(
        &self,
        here: impl Iterator<Item = Point>,
        direction_rad: f64,
        length_m: f64,
    ) -> (f64, f64) {
        let turn = nalgebra::Rotation2::new(-direction_rad);
        let along = -self.half_width_m..=length_m.min(self.ahead_m / 2.0);
        let mut sides_m = (self.side_max_m, self.side_max_m);
        for place in here.map(|place| turn * place) {
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
    /// without a return are left out; they are gone through four times, and nothing is
    /// allocated. Returns whether there is a way on: without one the road
    /// ends in front of the robot.
    ///
    /// A direction without a return counts as free. Ways are looked for up to 80 degrees to
    /// each side of the heading: for a scanner that sees less, the caller adds a return in
    /// each degree of this sector in which no beam looks, a little less than
    /// `2 * half_width_m` away; a way as short as that is none.
    pub fn fill(
        &self,
        observation: &mut Observation,
        scan: impl Iterator<Item = (f64, f64)> + Clone,
    ) -> bool {
        let place = |(direction_rad, range_m): (f64, f64)| {
            let (sin, cos) = f64::sin_cos(direction_rad);
            Point::new(range_m * cos, range_m * sin)
        };
        let returns = scan.map(place);
        let first = self.way(returns.clone(), &Pose::identity());
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
        let second = self.way(returns, &body_from_end);
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall across a hallway, seen by 2,048 beams over 270 degrees.
    fn scan() -> impl Iterator<Item = (f64, f64)> + Clone {
        (0..2048).filter_map(|beam| {
            let angle_rad = (f64::from(beam) / 2047.0 - 0.5) * 1.5 * std::f64::consts::PI;
            let (sin, cos) = angle_rad.sin_cos();
            let range_m = (2.0 / sin.abs()).min(15.0 / cos.max(1e-9));
            (range_m < 20.0).then_some((angle_rad, range_m))
        })
    }

    const SEARCH: Search = Search {
        half_width_m: 0.7,
        ahead_m: 18.0,
        side_max_m: 20.0,
    };

    #[test]
    fn a_scan_of_2048_beams_allocates_nothing() {
        let mut observation = Observation::default();
        let mut is_free = false;
        let counted = allocation_counter::measure(|| {
            is_free = SEARCH.fill(&mut observation, scan());
        });
        assert!(is_free, "{:?}", observation.road);
        let road = &observation.road;
        assert!((road.left_m - 2.0).abs() < 1e-9 && (road.right_m - 2.0).abs() < 1e-9);
        assert!((observation.checkpoints[0].x_body_m - 13.0).abs() < 0.1);
        assert_eq!(counted.count_total, 0);
    }

    #[test]
    fn the_free_way_of_each_direction_is_that_of_all_returns() {
        for (x, y) in [(0.0, 0.0), (4.0, 1.0), (9.0, -1.9), (14.9, 0.3)] {
            let place = |(rad, range_m): (f64, f64)| {
                Point::new(range_m * rad.cos() - x, range_m * rad.sin() - y)
            };
            let free_m = SEARCH.free_m(scan().map(place));
            for (index, free_m) in free_m.into_iter().enumerate() {
                let turn = nalgebra::Rotation2::new(-direction_rad(index));
                let in_way = scan()
                    .map(|beam| turn * place(beam))
                    .filter(|place| place.x > 0.0 && place.y.abs() < SEARCH.half_width_m);
                let least_m = in_way.fold(SEARCH.ahead_m, |least_m, place| least_m.min(place.x));
                assert_eq!(free_m, least_m, "direction {index} from {x}, {y}");
            }
        }
    }
}
