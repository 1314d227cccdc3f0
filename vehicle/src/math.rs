//! The mathematical functions that `core` does not have.
//!
//! With the feature `std` they are the host's C library, bit by bit: digests and
//! recordings rest on that. Without it they are those of the crate libm.

#[cfg(not(any(feature = "std", feature = "libm")))]
compile_error!("vehicle: enable the feature `std`, or `libm` without a standard library");

/// Sine and cosine of an angle, rad.
#[inline]
pub fn sin_cos(angle_rad: f64) -> (f64, f64) {
    #[cfg(feature = "std")]
    return angle_rad.sin_cos();
    #[cfg(all(not(feature = "std"), feature = "libm"))]
    return libm::sincos(angle_rad);
}

/// Tangent of an angle, rad.
#[inline]
pub fn tan(angle_rad: f64) -> f64 {
    #[cfg(feature = "std")]
    return angle_rad.tan();
    #[cfg(all(not(feature = "std"), feature = "libm"))]
    return libm::tan(angle_rad);
}

/// Angle of the direction (x, y), rad, in [-pi, pi].
#[inline]
pub fn atan2(y: f64, x: f64) -> f64 {
    #[cfg(feature = "std")]
    return y.atan2(x);
    #[cfg(all(not(feature = "std"), feature = "libm"))]
    return libm::atan2(y, x);
}

/// Length of the hypotenuse over two sides, in their unit.
#[inline]
pub fn hypot(x: f64, y: f64) -> f64 {
    #[cfg(feature = "std")]
    return x.hypot(y);
    #[cfg(all(not(feature = "std"), feature = "libm"))]
    return libm::hypot(x, y);
}

/// The least whole number that is not less than `value`.
#[inline]
pub fn ceil(value: f64) -> f64 {
    #[cfg(feature = "std")]
    return value.ceil();
    #[cfg(all(not(feature = "std"), feature = "libm"))]
    return libm::ceil(value);
}

/// Remainder of a division by a positive number, in [0, `divisor`].
#[inline]
pub fn rem_euclid(value: f64, divisor: f64) -> f64 {
    let rest = value % divisor;
    if rest < 0.0 { rest + divisor } else { rest }
}
