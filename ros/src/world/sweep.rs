//! A scan on the beams of `[scanner]`.

use std::f64::consts::{FRAC_PI_2, TAU};

use vehicle::{Fan, wrap_rad};

use crate::inbound::{LaserScan, Refused};

/// Two angles that are the same but for rounding, in gaps of the scan.
const ROUNDING: f64 = 1e-6;

/// Fills the range of each beam of a fan from a scan whose frame has this heading in the body
/// frame, rad. Of several ranges in the sector of a beam the shortest counts; a beam that met
/// nothing gets `max_m`.
///
/// # Errors
/// When the fan looks where the scan does not: what is not seen shall not pass for free.
pub fn sweep(
    scan: &LaserScan,
    heading_rad: f64,
    fan: &Fan,
    (max_m, into): (f32, &mut [f32]),
) -> Result<(), Refused> {
    let count = scan.ranges_m.len();
    let half_rad = (count - 1) as f64 * scan.increment_rad / 2.0;
    let is_circle = 2.0 * half_rad + 1.5 * scan.increment_rad >= TAU;
    let middle_rad = heading_rad + scan.first_rad + half_rad;
    // Half of a beam's sector, but not behind the car for a fan of few beams.
    let sector_rad = (fan.spacing_rad() / 2.0).min(FRAC_PI_2);
    let beside_rad = half_rad + scan.increment_rad / 2.0 + sector_rad;
    // Ranges on each side of the nearest one that are in the sector, too; each stands for half
    // a gap on both of its sides.
    let reach = (sector_rad / scan.increment_rad - 0.5 - ROUNDING)
        .ceil()
        .max(0.0) as usize;
    for (beam, range_m) in into.iter_mut().enumerate().take(fan.beams) {
        let off_rad = wrap_rad(fan.angle_rad(beam) - middle_rad);
        if !is_circle && off_rad.abs() > beside_rad {
            return Err(Refused(
                "it does not look where [scanner] says that beams look",
            ));
        }
        let nearest = ((off_rad + half_rad) / scan.increment_rad).round().max(0.0) as usize;
        // Counted from one round on, so that no number is negative.
        let sector = nearest + count - reach.min(count)..=nearest + count + reach.min(count);
        let mut least_m = max_m;
        for place in sector {
            let place = match is_circle {
                true => Some(place % count),
                false => place.checked_sub(count).map(|place| place.min(count - 1)),
            };
            // Infinity where nothing was met.
            least_m = least_m.min(place.map_or(max_m, |place| scan.ranges_m[place]));
        }
        *range_m = least_m;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use vehicle::{Point, Scanner};

    use super::*;
    use crate::inbound::Header;

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
        sweep(scan, heading_deg.to_radians(), fan, (50.0, &mut into))?;
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
    fn fewer_ranges_serve_more_beams() {
        let swept = swept(
            &scan(-90.0, 90.0, vec![1.0, 2.0, 3.0]),
            0.0,
            &fan(181, 180.0),
        );
        let swept = swept.expect("it covers the fan");
        assert_eq!([swept[0], swept[90], swept[180]], [1.0, 2.0, 3.0]);
        assert!(swept.iter().all(|range_m| *range_m < 50.0), "{swept:?}");
    }

    #[test]
    fn what_is_not_seen_does_not_pass_for_free() {
        let front = scan(-90.0, 1.0, vec![f32::INFINITY; 181]);
        assert!(swept(&front, 0.0, &fan(181, 180.0)).is_ok());
        assert!(swept(&front, 0.0, &fan(240, 360.0)).is_err());
        assert!(swept(&front, 180.0, &fan(181, 180.0)).is_err());
        assert!(swept(&scan(0.0, 1.0, vec![1.0]), 0.0, &fan(181, 180.0)).is_err());
    }
}
