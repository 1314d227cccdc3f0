//! The lidar of an observation.

use shm_config::message::Observation;

/// Fills the beams of an observation, as many as its fan has: that of the run's scanner,
/// which [`read`](crate::Robot::read) is given. `range_m` gives the distance from the
/// scanner's place to what a beam meets, m, in a direction counter-clockwise from the
/// heading of the body, rad: [`Fan::angle_rad`](vehicle::Fan::angle_rad) of each beam. It is
/// not asked for directions in which no beam looks. A beam that meets nothing may give
/// infinity or NaN, and reads `lidar_max_m`.
pub fn scan(observation: &mut Observation, range_m: impl Fn(f64) -> f64) {
    let fan = observation.fan();
    let max_m = observation.lidar_max_m;
    for (beam, range) in observation.ranges_m[..fan.beams].iter_mut().enumerate() {
        let met_m = range_m(fan.angle_rad(beam)) as f32;
        // `min` takes the other number in place of NaN.
        *range = met_m.min(max_m).max(0.0);
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use shm_config::message::{BEAMS_MAX, Message};
    use vehicle::Scanner;

    use super::*;

    /// An observation of a scanner with this many beams over these degrees.
    fn observed(beams: u32, field_of_view_deg: f64) -> Observation {
        let scanner = Scanner {
            beams,
            field_of_view_deg,
            ..Scanner::default()
        };
        let mut observation = Observation::default();
        observation.set_fan(&scanner.fan());
        observation
    }

    #[test]
    fn beams_without_a_return_read_the_greatest_range() {
        let mut observation = observed(4, 360.0);
        let ranges = [3.0, f64::NAN, f64::INFINITY, -1.0];
        let fan = observation.fan();
        scan(&mut observation, |direction_rad| {
            ranges[fan.beam_at(direction_rad).round() as usize]
        });
        let max_m = observation.lidar_max_m;
        assert_eq!(observation.ranges(), [3.0, max_m, max_m, 0.0]);
        assert_eq!(observation.check(), Ok(()));
        let mut observation = Observation {
            beam_count: BEAMS_MAX as u32 + 1,
            ..observation
        };
        scan(&mut observation, |_| 1.0);
        assert_eq!(observation.ranges(), [1.0; BEAMS_MAX]);
    }

    #[test]
    fn only_directions_in_which_a_beam_looks_are_asked_for() {
        let mut observation = observed(4, 270.0);
        let asked_deg = RefCell::new(Vec::new());
        scan(&mut observation, |direction_rad| {
            asked_deg
                .borrow_mut()
                .push(direction_rad.to_degrees().round());
            1.0
        });
        assert_eq!(asked_deg.into_inner(), [-135.0, -45.0, 45.0, 135.0]);
        assert_eq!(observation.field_of_view_rad, 270_f64.to_radians());
    }
}
