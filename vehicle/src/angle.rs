use core::f64::consts::{PI, TAU};

use crate::math;

/// The same angle in (-pi, pi].
///
/// Non-finite input gives NaN.
pub fn wrap_rad(angle_rad: f64) -> f64 {
    let wrapped = math::rem_euclid(angle_rad, TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}
