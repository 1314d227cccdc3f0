use std::f64::consts::PI;

use nalgebra::Matrix3;
use shm_config::Instant;
use vehicle::Pose;

use super::EstimateError;

/// What a sensor measured at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measurement {
    /// Odometry of the wheels.
    Wheels {
        /// Speed along the heading, m/s; negative backwards.
        speed_mps: f64,
        /// Angle of the front wheels, rad, positive left, within 80 degrees; `None` where
        /// it is not measured.
        steer_rad: Option<f64>,
    },
    /// Gyroscope and accelerometer.
    Imu {
        /// Turning rate, rad/s, counter-clockwise.
        yaw_rate_radps: f64,
        /// Acceleration along the heading, m/s².
        accel_mps2: f64,
    },
    /// The motion since the newest keyframe, such as by [`align`](super::align()).
    Motion {
        /// The instant of the keyframe.
        since: Instant,
        /// The body of now in the body frame of the keyframe.
        keyframe_from_body: Pose,
        /// Inverse covariance of (x, y, heading) in this frame, m and rad; a direction that
        /// was not observed has none.
        information: Matrix3<f64>,
    },
    /// The pose on a map.
    Place {
        /// The body in the world.
        world_from_body: Pose,
        /// Inverse covariance of (x, y, heading), m and rad; a direction that was not
        /// observed has none.
        information: Matrix3<f64>,
    },
    /// The next motions begin at the pose of this instant.
    Keyframe,
}

/// Largest distance from the origin, m: that of an observation.
const PLACE_MAX_M: f64 = 1e6;
/// Largest speed, m/s, and turning rate, rad/s: those of an observation.
const SPEED_MAX_MPS: f64 = 150.0;
const YAW_RATE_MAX_RADPS: f64 = 100.0;
/// Largest acceleration, m/s²: a hundred times gravity is a broken sensor.
const ACCEL_MAX_MPS2: f64 = 1e3;
/// Largest angle of the wheels, rad: the tangent diverges at 90 degrees.
const STEER_MAX_RAD: f64 = 80.0 / 180.0 * PI;
/// Eigenvalues below this share of the largest are none: rounding makes them.
pub(super) const INFORMATION_MIN: f64 = 1e-9;

impl Measurement {
    /// The number of its kind. Measurements of one instant are applied in this order, in
    /// whichever order they arrive; a keyframe is then the pose after all of them.
    pub(super) fn kind(&self) -> usize {
        match self {
            Self::Wheels { .. } => 0,
            Self::Imu { .. } => 1,
            Self::Motion { .. } => 2,
            Self::Place { .. } => 3,
            Self::Keyframe => 4,
        }
    }

    /// Refuses what no sensor measures.
    pub(super) fn check(&self) -> Result<(), EstimateError> {
        match self {
            Self::Wheels {
                speed_mps,
                steer_rad,
            } => {
                within("speed_mps", *speed_mps, SPEED_MAX_MPS)?;
                within("steer_rad", steer_rad.unwrap_or(0.0), STEER_MAX_RAD)
            }
            Self::Imu {
                yaw_rate_radps,
                accel_mps2,
            } => {
                within("yaw_rate_radps", *yaw_rate_radps, YAW_RATE_MAX_RADPS)?;
                within("accel_mps2", *accel_mps2, ACCEL_MAX_MPS2)
            }
            Self::Motion {
                keyframe_from_body: pose,
                information,
                ..
            }
            | Self::Place {
                world_from_body: pose,
                information,
            } => {
                within("x_m", pose.translation.x, PLACE_MAX_M)?;
                within("y_m", pose.translation.y, PLACE_MAX_M)?;
                within("heading_rad", pose.rotation.angle(), PI)?;
                informs(information)
            }
            Self::Keyframe => Ok(()),
        }
    }
}

/// A number of at most this size.
fn within(name: &'static str, value: f64, limit: f64) -> Result<(), EstimateError> {
    // False for NaN, too.
    match value.abs() <= limit {
        true => Ok(()),
        false => Err(EstimateError::Value { name, value }),
    }
}

/// An information matrix that has at least one direction.
fn informs(information: &Matrix3<f64>) -> Result<(), EstimateError> {
    let scale = information.amax();
    // A standard deviation of a nanometre is the limit.
    let is_sized = information.iter().all(|number| number.is_finite())
        && scale > 0.0
        && scale <= 1.0 / (1e-9 * 1e-9);
    let is_symmetric = (information - information.transpose()).amax() <= 1e-9 * scale;
    if !is_sized || !is_symmetric {
        return Err(EstimateError::Information);
    }
    let least = information.symmetric_eigenvalues().min();
    match least >= -INFORMATION_MIN * scale {
        true => Ok(()),
        false => Err(EstimateError::Information),
    }
}
