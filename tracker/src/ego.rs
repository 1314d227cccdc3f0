use shm_config::message::Ego;
use vehicle::{Action, Vehicle};

use crate::kalman::Kalman;

/// Time in which the turning rate follows the wheels to 1/e, s: each of the
/// simulator's sub-steps of 0.02 s takes a fifth of the tyres' slip away.
pub const YAW_LAG_S: f64 = 0.09;
/// How well speeds, m/s, and turning rates, rad/s, are measured.
const SPEED_DEVIATION: f64 = 0.05;
const YAW_RATE_DEVIATION: f64 = 0.02;
/// How fast a gain may change, per root of a second.
const GAIN_DRIFT: f64 = 0.05;
/// Gains are kept within these.
const GAINS: (f64, f64) = (0.5, 2.0);
/// Slower than this the wheels tell nothing of the steering, m/s.
const MOVING_MPS: f64 = 1.0;

/// The filter over the car itself: speed and turning rate without the noise,
/// and how strongly engine and steering answer, compared with the model. The
/// simulator draws the engine's force for each episode.
#[derive(Debug, Clone, Copy)]
pub struct EgoFilter {
    speed: Kalman,
    yaw_rate: Kalman,
}

impl EgoFilter {
    /// At the first observation of an episode.
    pub fn new(ego: &Ego) -> Self {
        Self {
            speed: Kalman::new((ego.speed_mps, SPEED_DEVIATION), (1.0, 0.1)),
            yaw_rate: Kalman::new((ego.yaw_rate_radps, YAW_RATE_DEVIATION), (1.0, 0.1)),
        }
    }

    /// One observation later by `step_s`.
    pub fn update(&mut self, ego: &Ego, vehicle: &Vehicle, step_s: f64) {
        let action = Action {
            steer: ego.steer,
            pedal: ego.pedal,
        };
        let control = action.control(vehicle);
        let noise = GAIN_DRIFT * step_s.sqrt();
        let keep = (-step_s / YAW_LAG_S).exp();
        let wanted_radps = ego.speed_mps * control.steer_rad.tan() / vehicle.wheelbase_m;
        // Only the engine's gain is asked for: the brake is limited by friction,
        // and a standing car tells nothing.
        let (drive, noise_speed) = match action.pedal > 0.0 && ego.speed_mps > MOVING_MPS {
            true => (control.accel_mps2 * step_s, noise),
            false => (0.0, 0.0),
        };
        self.speed.predict(1.0, drive, noise_speed);
        if drive == 0.0 {
            self.speed = Kalman::new((ego.speed_mps, SPEED_DEVIATION), (self.engine_gain(), 0.05));
        }
        self.speed.measure(ego.speed_mps, SPEED_DEVIATION);
        self.yaw_rate
            .predict(keep, (1.0 - keep) * wanted_radps, noise);
        self.yaw_rate
            .measure(ego.yaw_rate_radps, YAW_RATE_DEVIATION);
    }

    /// Speed, m/s.
    pub fn speed_mps(&self) -> f64 {
        self.speed.value().max(0.0)
    }

    /// Turning rate, rad/s, counter-clockwise.
    pub fn yaw_rate_radps(&self) -> f64 {
        self.yaw_rate.value()
    }

    /// Acceleration at full pedal, compared with the model's.
    pub fn engine_gain(&self) -> f64 {
        self.speed.driver().clamp(GAINS.0, GAINS.1)
    }

    /// Turning rate at an angle of the wheels, compared with the model's.
    pub fn steering_gain(&self) -> f64 {
        self.yaw_rate.driver().clamp(GAINS.0, GAINS.1)
    }
}
