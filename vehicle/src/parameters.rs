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
        }
    }
}

/// A constant of the car that no car can have.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{name} = {value}: must be a positive number at most {limit}")]
pub struct InvalidVehicle {
    /// The field's name.
    pub name: &'static str,
    /// What it was.
    pub value: f64,
    /// The most it may be.
    pub limit: f64,
}

impl Vehicle {
    /// Wheel angle at `steer = 1`, rad.
    pub fn max_steer_rad(&self) -> f64 {
        self.max_steer_deg.to_radians()
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
    /// The first constant that is not finite, not positive, or beyond its limit.
    pub fn validated(self) -> Result<Self, InvalidVehicle> {
        // A wheel at 90 degrees has no turning circle: tan() diverges.
        let rows = [
            ("length_m", self.length_m, 30.0),
            ("width_m", self.width_m, 10.0),
            ("wheelbase_m", self.wheelbase_m, 20.0),
            ("max_steer_deg", self.max_steer_deg, 80.0),
            ("max_accel_mps2", self.max_accel_mps2, 50.0),
            ("max_brake_mps2", self.max_brake_mps2, 50.0),
            ("max_speed_mps", self.max_speed_mps, 100.0),
        ];
        for (name, value, limit) in rows {
            if !(value > 0.0 && value <= limit) {
                return Err(InvalidVehicle { name, value, limit });
            }
        }
        Ok(self)
    }
}
