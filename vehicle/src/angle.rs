use std::f64::consts::{PI, TAU};

/// The same angle in (-pi, pi].
///
/// Non-finite input gives NaN.
pub fn wrap_rad(angle_rad: f64) -> f64 {
    let wrapped = angle_rad.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}
