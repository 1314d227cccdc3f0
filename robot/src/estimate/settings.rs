use shm_config::Instant;

use super::EstimateError;

/// Greatest NIS of one, two and three numbers that is applied: one true measurement in a
/// thousand is above (quantiles of chi-square at 0.999).
pub const GATE: [f64; 3] = [10.828, 13.816, 16.266];

/// What the filter accepts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Oldest measurement that is applied, s before `now`.
    pub delay_s: f64,
    /// Distance between the axles, m.
    pub wheelbase_m: f64,
    /// Places that are rejected in succession before the next one is applied in spite of its
    /// gate, the covariance first multiplied by its NIS over the gate. Nothing but places
    /// makes a wrong place right: a filter that rejects them would do so for good.
    pub places_rejected_max: u32,
}

impl Default for Settings {
    /// Half a second, the wheelbase of the default car, and half a second of scans at 10 Hz.
    fn default() -> Self {
        Self {
            delay_s: 0.5,
            wheelbase_m: vehicle::Vehicle::default().wheelbase_m,
            places_rejected_max: 5,
        }
    }
}

/// Standard deviations of the sensors, and how fast the car changes its motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Speed of the wheels, m/s.
    pub speed_mps: f64,
    /// Angle of the front wheels, rad.
    pub steer_rad: f64,
    /// Turning rate that the bicycle does not explain, rad/s.
    pub slip_radps: f64,
    /// Gyroscope, rad/s.
    pub yaw_rate_radps: f64,
    /// Accelerometer, m/s².
    pub accel_mps2: f64,
    /// Change of the turning rate in one second, rad/s.
    pub turn_change: f64,
    /// Change of the acceleration in one second, m/s².
    pub accel_change: f64,
    /// Change of the gyroscope's bias in one second, rad/s.
    pub gyro_bias_change: f64,
    /// Change of the accelerometer's bias in one second, m/s².
    pub accel_bias_change: f64,
}

impl Default for Noise {
    /// Sensors of a small vehicle; the changes are those of a car that brakes fully and
    /// turns its wheels by a quarter of their range from one tick of 10 Hz to the next.
    fn default() -> Self {
        Self {
            speed_mps: 0.1,
            steer_rad: 0.01,
            slip_radps: 0.02,
            yaw_rate_radps: 0.01,
            accel_mps2: 0.2,
            turn_change: 1.0,
            accel_change: 20.0,
            gyro_bias_change: 1e-4,
            accel_bias_change: 1e-3,
        }
    }
}

/// What is known at the beginning: values, and standard deviations of the same units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    /// When.
    pub at: Instant,
    /// The state ([`STATES`](super::STATES) numbers).
    pub mean: [f64; super::STATES],
    /// Its standard deviations; all above 0.
    pub std: [f64; super::STATES],
}

impl Default for Start {
    /// At the origin, standing, as a car that was put there by hand.
    fn default() -> Self {
        Self {
            at: Instant(0),
            mean: [0.0; super::STATES],
            std: [0.1, 0.1, 0.02, 0.1, 0.02, 0.1, 0.01, 0.1],
        }
    }
}

/// Checks numbers against their ranges.
fn in_ranges(rows: &[(&'static str, f64, [f64; 2])]) -> Result<(), EstimateError> {
    for &(name, value, range) in rows {
        if !(value >= range[0] && value <= range[1]) {
            return Err(EstimateError::Setting { name, value, range });
        }
    }
    Ok(())
}

impl Settings {
    /// Checks every number.
    ///
    /// # Errors
    /// The first that is out of range.
    pub fn check(&self) -> Result<(), EstimateError> {
        in_ranges(&[
            ("delay_s", self.delay_s, [0.0, 10.0]),
            ("wheelbase_m", self.wheelbase_m, [0.02, 30.0]),
        ])
    }
}

impl Noise {
    /// Checks every number: none may be 0, for a sensor without noise would be believed
    /// against all others.
    ///
    /// # Errors
    /// The first that is out of range.
    pub fn check(&self) -> Result<(), EstimateError> {
        let range = [1e-9, 1e6];
        in_ranges(&[
            ("speed_mps", self.speed_mps, range),
            ("steer_rad", self.steer_rad, range),
            ("slip_radps", self.slip_radps, range),
            ("yaw_rate_radps", self.yaw_rate_radps, range),
            ("accel_mps2", self.accel_mps2, range),
            ("turn_change", self.turn_change, range),
            ("accel_change", self.accel_change, range),
            ("gyro_bias_change", self.gyro_bias_change, range),
            ("accel_bias_change", self.accel_bias_change, range),
        ])
    }

    /// The same with every standard deviation multiplied.
    #[must_use]
    pub fn times(&self, factor: f64) -> Self {
        Self {
            speed_mps: self.speed_mps * factor,
            steer_rad: self.steer_rad * factor,
            slip_radps: self.slip_radps * factor,
            yaw_rate_radps: self.yaw_rate_radps * factor,
            accel_mps2: self.accel_mps2 * factor,
            turn_change: self.turn_change * factor,
            accel_change: self.accel_change * factor,
            gyro_bias_change: self.gyro_bias_change * factor,
            accel_bias_change: self.accel_bias_change * factor,
        }
    }
}

impl Start {
    /// Checks every number.
    ///
    /// # Errors
    /// The first that is out of range.
    pub fn check(&self) -> Result<(), EstimateError> {
        for value in self.mean {
            in_ranges(&[("start", value, [-1e6, 1e6])])?;
        }
        for value in self.std {
            in_ranges(&[("the start's deviation", value, [1e-9, 1e6])])?;
        }
        Ok(())
    }
}
