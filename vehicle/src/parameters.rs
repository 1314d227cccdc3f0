use serde::{Deserialize, Serialize};

use crate::Footprint;

/// The car's constants. The defaults are MetaDrive's default vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Vehicle {
    /// Length of the body, m.
    pub length_m: f64,
    /// Width of the body, m.
    pub width_m: f64,
    /// Distance between the axles, m: `L` of Eq. 5.
    pub wheelbase_m: f64,
    /// Wheel angle at `steer = 1`, degrees: `delta_max` of Sec. 8.4.
    pub max_steer_deg: f64,
    /// Acceleration at `pedal = 1`, m/s²: `a_max` of Sec. 8.4. The paper gives
    /// no figure; 2.76 is measured of the simulator's weakest engine.
    pub max_accel_mps2: f64,
    /// Deceleration at `pedal = -1`, m/s²; tyre friction limits it (measured).
    pub max_brake_mps2: f64,
    /// Top speed, m/s (80 km/h).
    pub max_speed_mps: f64,
    /// Time from a command to its effect on wheels, engine and brakes, ms; the built-in
    /// world rounds it to its sub-steps of 20 ms.
    pub delay_ms: f64,
}

impl Default for Vehicle {
    fn default() -> Self {
        Self {
            length_m: 4.515,
            width_m: 1.852,
            wheelbase_m: 2.469,
            max_steer_deg: 40.0,
            max_accel_mps2: 2.76,
            max_brake_mps2: 11.8,
            max_speed_mps: 80.0 / 3.6,
            delay_ms: 0.0,
        }
    }
}

/// A constant of the car that no car can have.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{name} = {value}: must be within {} and {}", .range[0], .range[1])]
pub struct InvalidVehicle {
    /// The field's name.
    pub name: &'static str,
    /// What it was.
    pub value: f64,
    /// The least and the most it may be.
    pub range: [f64; 2],
}

impl Vehicle {
    /// Wheel angle at `steer = 1`, rad.
    pub fn max_steer_rad(&self) -> f64 {
        self.max_steer_deg.to_radians()
    }

    /// Time from a command to its effect, s.
    pub fn delay_s(&self) -> f64 {
        self.delay_ms / 1e3
    }

    /// The body's rectangle.
    pub fn footprint(&self) -> Footprint {
        Footprint {
            length_m: self.length_m,
            width_m: self.width_m,
        }
    }

    /// Checks every constant.
    ///
    /// # Errors
    /// The first constant that is not finite or outside its range, or axles farther
    /// apart than the body is long.
    pub fn validated(self) -> Result<Self, InvalidVehicle> {
        // The least car is a model of 1:40. A wheel at 90 degrees has no turning circle:
        // tan() diverges.
        let rows = [
            ("length_m", self.length_m, [0.05, 30.0]),
            ("width_m", self.width_m, [0.02, 10.0]),
            ("wheelbase_m", self.wheelbase_m, [0.02, self.length_m]),
            ("max_steer_deg", self.max_steer_deg, [1.0, 80.0]),
            ("max_accel_mps2", self.max_accel_mps2, [0.05, 50.0]),
            ("max_brake_mps2", self.max_brake_mps2, [0.1, 50.0]),
            ("max_speed_mps", self.max_speed_mps, [0.05, 100.0]),
            ("delay_ms", self.delay_ms, [0.0, 1000.0]),
        ];
        in_ranges(&rows)?;
        Ok(self)
    }
}

/// Checks numbers against their ranges.
///
/// # Errors
/// The first that is not finite or outside.
pub(crate) fn in_ranges(rows: &[(&'static str, f64, [f64; 2])]) -> Result<(), InvalidVehicle> {
    for &(name, value, range) in rows {
        if !(value >= range[0] && value <= range[1]) {
            return Err(InvalidVehicle { name, value, range });
        }
    }
    Ok(())
}
