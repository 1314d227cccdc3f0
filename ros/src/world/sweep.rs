//! A scan on the beams of `[scanner]`.

use std::f64::consts::{FRAC_PI_2, TAU};

use vehicle::{Fan, wrap_rad};

use crate::inbound::{LaserScan, Refused};

/// Two angles that are the same but for rounding, rad: those of a scan are 32-bit floats.
const ROUNDING_RAD: f64 = 1e-6;
/// Two neighbouring ranges are near enough for a fan of few beams when they are at most as far
/// apart as its beams, but no farther than this, rad: five degrees, which is what a fan sees
/// beside its outermost beam.
const GAP_MAX_RAD: f64 = 5.0 / 180.0 * std::f64::consts::PI;
/// A beam beside which only one range was measured may be this share of a gap from it.
const ALONG: f64 = 0.25;

const OUTSIDE: Refused = Refused("it does not look where [scanner] says that beams look");
const GAP: Refused = Refused(
    "a place within range_m of [scanner] is farther than the car's width from each of its ranges: \
     its angle increment is too large, or ranges between are NaN or below range_min",
);

/// Fills the beams of a fan from scans.
///
/// Readers of an observation assume that each beam was measured: a place beside a beam
/// by at most the car's width is seen. So a beam has to lie between two measured ranges that
/// leave no room for more than that between them, or along a measured range. Anything else
/// refuses the scan: what is not seen shall not pass for free.
#[derive(Debug, Clone, Copy)]
pub struct Sweep {
    fan: Fan,
    /// Range of a beam that met nothing, m.
    max_m: f64,
    /// Half of the angle in which a range counts for a beam, beside half of an increment, rad.
    sector_rad: f64,
    /// Largest angle between two neighbouring ranges, rad.
    gap_rad: f64,
}

impl Sweep {
    /// For this fan of this range, m, on a car of this width, m.
    pub fn new(fan: Fan, range_m: f64, width_m: f64) -> Self {
        // The middle between two ranges is the car's width beside both.
        let car_rad = 2.0 * (width_m / range_m).min(1.0).asin();
        Self {
            fan,
            max_m: range_m,
            // Not behind the car for a fan of few beams.
            sector_rad: (fan.spacing_rad() / 2.0).min(FRAC_PI_2),
            gap_rad: car_rad.max(fan.spacing_rad().min(GAP_MAX_RAD)),
        }
    }

    /// Fills the range of each beam from a scan whose frame has this heading in the body
    /// frame, rad. Of several ranges in the sector of a beam the shortest counts; a beam that
    /// met nothing gets the fan's own range.
    ///
    /// # Errors
    /// When a beam looks where the scan does not. Part of `into` may be filled then.
    pub fn fill(
        &self,
        scan: &LaserScan,
        heading_rad: f64,
        into: &mut [f32],
    ) -> Result<(), Refused> {
        let measured = Measured::of(scan);
        if measured.rays.is_empty() {
            return Err(GAP);
        }
        let first_rad = heading_rad + scan.first_rad;
        let reach_rad = self.sector_rad + scan.increment_rad / 2.0 - ROUNDING_RAD;
        for (beam, into) in into.iter_mut().enumerate().take(self.fan.beams) {
            let beam_rad = wrap_rad(self.fan.angle_rad(beam) - first_rad).rem_euclid(TAU);
            let next = measured.after(beam_rad);
            let [right, left] = [measured.ray(next - 1), measured.ray(next)];
            let nearest_rad = (beam_rad - right.0).min(left.0 - beam_rad);
            let is_between = left.0 - right.0 <= self.gap_rad + ROUNDING_RAD;
            if !is_between && nearest_rad > self.gap_rad * ALONG {
                let whole_rad = (scan.ranges_m.len() - 1) as f64 * scan.increment_rad;
                return Err(match beam_rad > whole_rad {
                    true => OUTSIDE,
                    false => GAP,
                });
            }
            // Where no range of the sector was measured, both of its neighbours count.
            let least_m = measured.least_m(next, (beam_rad, reach_rad));
            let least_m = least_m.unwrap_or(right.1.min(left.1));
            *into = least_m.min(self.max_m as f32);
        }
        Ok(())
    }
}

/// The ranges that were measured: direction from the first range, rad, in order, and range, m.
struct Measured {
    rays: Vec<(f64, f32)>,
}

impl Measured {
    fn of(scan: &LaserScan) -> Self {
        let rays = scan.ranges_m.iter().enumerate();
        let rays = rays.filter(|(_, range_m)| !range_m.is_nan());
        Self {
            rays: rays
                .map(|(k, range_m)| (k as f64 * scan.increment_rad, *range_m))
                .collect(),
        }
    }

    /// The number of the first ray beyond a direction.
    fn after(&self, angle_rad: f64) -> isize {
        self.rays.partition_point(|ray| ray.0 <= angle_rad) as isize
    }

    /// A ray; those before the first and beyond the last are of the rounds before and after.
    fn ray(&self, number: isize) -> (f64, f32) {
        let count = self.rays.len() as isize;
        let (angle_rad, range_m) = self.rays[number.rem_euclid(count) as usize];
        let rounds = number.div_euclid(count) as f64;
        (angle_rad + rounds * TAU, range_m)
    }

    /// The shortest range within `reach_rad` of a direction whose next ray is known; `None`
    /// without one.
    fn least_m(&self, next: isize, (angle_rad, reach_rad): (f64, f64)) -> Option<f32> {
        let count = self.rays.len() as isize;
        let right = (next - count..next).rev().map(|number| self.ray(number));
        let right = right.take_while(|ray| angle_rad - ray.0 <= reach_rad);
        let left = (next..next + count).map(|number| self.ray(number));
        let left = left.take_while(|ray| ray.0 - angle_rad <= reach_rad);
        right.chain(left).map(|ray| ray.1).reduce(f32::min)
    }
}

#[cfg(test)]
mod tests {
    use vehicle::{Point, Scanner};

    use super::*;
    use crate::inbound::Header;

    /// Over 50 m, two ranges 4 degrees apart leave no room for twice this between them, and
    /// two 5 degrees apart do.
    const WIDTH_M: f64 = 1.852;

    fn scan(first_deg: f64, increment_deg: f64, ranges_m: Vec<f32>) -> LaserScan {
        LaserScan {
            header: Header {
                stamp_ns: 0,
                frame: "laser".into(),
            },
            first_rad: first_deg.to_radians(),
            increment_rad: increment_deg.to_radians(),
            ranges_m,
        }
    }

    fn fan(beams: u32, field_of_view_deg: f64) -> Fan {
        let scanner = Scanner {
            beams,
            field_of_view_deg,
            ..Scanner::default()
        };
        scanner.fan()
    }

    fn swept(scan: &LaserScan, heading_deg: f64, fan: &Fan) -> Result<Vec<f32>, Refused> {
        let mut into = vec![-1.0; fan.beams];
        let sweep = Sweep::new(*fan, 50.0, WIDTH_M);
        sweep.fill(scan, heading_deg.to_radians(), &mut into)?;
        Ok(into)
    }

    #[test]
    fn the_same_beams_keep_their_ranges() {
        let ranges: Vec<f32> = (0..1080).map(|k| 1.0 + k as f32 * 0.01).collect();
        let scan = scan(-135.0, 270.0 / 1079.0, ranges.clone());
        let fan = fan(1080, 270.0);
        assert_eq!(fan.mount_body, Point::origin());
        assert_eq!(swept(&scan, 0.0, &fan), Ok(ranges));
    }

    #[test]
    fn a_thin_post_is_not_lost_between_fewer_beams() {
        for post in 0..360 {
            let mut ranges = vec![f32::INFINITY; 360];
            ranges[post] = 2.0;
            let swept = swept(&scan(-180.0, 1.0, ranges), 0.0, &fan(36, 360.0));
            let swept = swept.expect("a full circle");
            let hits = swept.iter().filter(|range_m| **range_m == 2.0).count();
            // In the middle between two beams it is in both sectors.
            assert!((1..=2).contains(&hits), "{post}: {swept:?}");
            assert_eq!(swept.iter().filter(|m| **m == 50.0).count(), 36 - hits);
        }
    }

    #[test]
    fn a_scanner_that_is_turned_sees_the_same_world() {
        // A wall on the left of the car.
        let mut ranges = vec![f32::INFINITY; 360];
        ranges[0] = 3.0;
        let swept = swept(&scan(0.0, 1.0, ranges), 90.0, &fan(4, 360.0));
        assert_eq!(swept, Ok(vec![50.0, 3.0, 50.0, 50.0]));
    }

    #[test]
    fn fewer_ranges_serve_more_beams_as_long_as_no_car_fits_between_them() {
        let ranges: Vec<f32> = (0..90).map(|k| 1.0 + k as f32).collect();
        let swept_4 = swept(&scan(-180.0, 4.0, ranges), 0.0, &fan(240, 360.0));
        let swept_4 = swept_4.expect("it covers the fan");
        // The first beam looks ahead, as range 45 does; the next ones 1.5 degrees on.
        assert_eq!(swept_4[..3], [46.0, 46.0, 47.0]);
        for (first_deg, increment_deg, count) in [
            (-180.0, 5.0, 72),
            (-180.0, 45.0, 8),
            (-120.0, 240.0, 2),
            (0.0, 240.0, 1),
            (-180.0, 120.0, 3),
        ] {
            let coarse = scan(first_deg, increment_deg, vec![9.0; count]);
            assert!(swept(&coarse, 0.0, &fan(240, 360.0)).is_err(), "{coarse:?}");
        }
        let three = scan(-90.0, 90.0, vec![1.0, 2.0, 3.0]);
        assert_eq!(swept(&three, 0.0, &fan(181, 180.0)), Err(GAP));
    }

    #[test]
    fn a_coarse_scanner_serves_a_fan_of_its_own_directions_alone() {
        let eight = scan(-180.0, 45.0, (0..8).map(|k| k as f32).collect());
        let expected = vec![4.0, 5.0, 6.0, 7.0, 0.0, 1.0, 2.0, 3.0];
        assert_eq!(swept(&eight, 0.0, &fan(8, 360.0)), Ok(expected));
        assert!(swept(&eight, 1.0, &fan(8, 360.0)).is_ok());
        assert_eq!(swept(&eight, 20.0, &fan(8, 360.0)), Err(GAP));
        assert_eq!(swept(&eight, 22.5, &fan(8, 360.0)), Err(GAP));
    }

    #[test]
    fn ranges_that_were_not_measured_leave_no_hole_for_a_car() {
        let with_hole = |first: usize, count: usize| {
            let mut ranges = vec![9.0; 360];
            ranges[first - 1] = 7.0;
            ranges[first..first + count].fill(f32::NAN);
            scan(-180.0, 1.0, ranges)
        };
        // The beams of the hole have the nearer one of its sides.
        let whole = swept(&with_hole(180, 3), 0.0, &fan(360, 360.0)).expect("a small hole");
        assert_eq!(whole[358..], [9.0, 7.0]);
        assert_eq!(whole[..4], [7.0, 7.0, 7.0, 9.0]);
        assert_eq!(swept(&with_hole(180, 4), 0.0, &fan(360, 360.0)), Err(GAP));
        assert_eq!(swept(&with_hole(180, 36), 0.0, &fan(240, 360.0)), Err(GAP));
        // Behind the car, where no beam looks.
        assert!(swept(&with_hole(10, 60), 0.0, &fan(181, 180.0)).is_ok());
        let nothing = scan(-180.0, 1.0, vec![f32::NAN; 360]);
        assert_eq!(swept(&nothing, 0.0, &fan(240, 360.0)), Err(GAP));
        // At the limit of what the scanner sees.
        let at_the_end = |count: usize| {
            let mut ranges = vec![9.0; 181];
            ranges[181 - count..].fill(f32::NAN);
            swept(&scan(-90.0, 1.0, ranges), 0.0, &fan(181, 180.0))
        };
        assert!(at_the_end(1).is_ok());
        assert_eq!(at_the_end(2), Err(GAP));
    }

    #[test]
    fn what_is_not_seen_does_not_pass_for_free() {
        let front = scan(-90.0, 1.0, vec![f32::INFINITY; 181]);
        assert!(swept(&front, 0.0, &fan(181, 180.0)).is_ok());
        assert_eq!(swept(&front, 0.0, &fan(240, 360.0)), Err(OUTSIDE));
        assert_eq!(swept(&front, 180.0, &fan(181, 180.0)), Err(OUTSIDE));
        assert!(swept(&scan(0.0, 1.0, vec![1.0]), 0.0, &fan(181, 180.0)).is_err());
    }
}
