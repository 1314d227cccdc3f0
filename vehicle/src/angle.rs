use core::f64::consts::{PI, TAU};

/// The same angle in (-pi, pi].
///
/// Non-finite input gives NaN.
pub fn wrap_rad(angle_rad: f64) -> f64 {
    let wrapped = rem_euclid(angle_rad, TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// Remainder of a division by a positive number, in [0, `divisor`]: the standard
/// library's, bit by bit, which `core` and [`Float`](crate::Float) do not have.
pub fn rem_euclid(value: f64, divisor: f64) -> f64 {
    let rest = value % divisor;
    if rest < 0.0 { rest + divisor } else { rest }
}
