//! How fast a car is tested and how long it may take, by its own limits: the test is the
//! same for a model of 1:40 and a truck.

use shm_config::config::Config;

/// The greatest speed at which steering and brake are tested, m/s: a brisk walk, for which
/// a course of some metres is enough.
const SPEED_MPS: f64 = 2.0;
/// A slower car is tested at this share of its greatest speed.
const SHARE: f64 = 0.8;
/// The most that a car may move after it stood, m/s: it rocks back on its springs. It is
/// half of what a slower car has with the pedal full down, so that this is found.
const STAYS_MPS: f64 = 0.25;
/// A car that is slower than this share of what it may move stands.
const STANDS: f64 = 0.4;
/// Time for which a car is watched that has to stay at a stand, s.
pub(super) const STAY_S: f64 = 1.0;

/// Speeds and times of the test of one car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pace {
    /// The speed at which steering and brake are tested, m/s.
    pub(super) speed_mps: f64,
    /// A car that is slower than this stands, m/s.
    pub(super) stands_mps: f64,
    /// The most that a car may move after it stood, m/s.
    pub(super) stays_mps: f64,
    /// Time from a command to its effect, s.
    pub(super) delay_s: f64,
    /// Time from the command until it has the speed of the test, s.
    pub(super) reach_s: f64,
    /// Time from the command until it stands, s.
    pub(super) brake_s: f64,
}

impl Pace {
    /// That of the car of a configuration.
    pub(super) fn of(config: &Config) -> Self {
        let car = &config.vehicle;
        let speed_mps = SPEED_MPS.min(SHARE * car.max_speed_mps);
        let pedal_mps = speed_mps.min(STAY_S * car.max_accel_mps2);
        let stays_mps = STAYS_MPS.min(pedal_mps / 2.0);
        let delay_s = car.delay_s();
        Self {
            speed_mps,
            stands_mps: STANDS * stays_mps,
            stays_mps,
            delay_s,
            reach_s: delay_s + speed_mps / car.max_accel_mps2,
            brake_s: delay_s + speed_mps / car.max_brake_mps2,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_car_is_tested_within_its_limits() {
        let mut config = Config::default();
        let default = Pace::of(&config);
        assert_eq!((default.speed_mps, default.stays_mps), (2.0, 0.25));
        assert_eq!(default.stands_mps, 0.1);
        config.vehicle.max_speed_mps = 0.5;
        config.vehicle.max_accel_mps2 = 0.2;
        config.vehicle.max_brake_mps2 = 0.1;
        config.vehicle.delay_ms = 500.0;
        let slow = Pace::of(&config);
        assert_eq!((slow.speed_mps, slow.stays_mps), (0.4, 0.1));
        assert_eq!((slow.reach_s, slow.brake_s), (2.5, 4.5));
    }
}
