//! A car of which only size, wheelbase and limits are known: the kinematic bicycle.
//!
//! Its axles lie half the wheelbase before and behind the body's centre. The rear axle
//! moves along the heading, without slip, so the centre moves along the heading plus the
//! slip angle of that point. A car that brakes at most at b cannot corner harder than b:
//! one friction limits both, and beyond it the curve gets wider.

use nalgebra::{Matrix3, Vector3};
use vehicle::{Vector, Vehicle};

use super::{Controls, Motion, SUBSTEP_S};

/// The same motion one sub-step (0.02 s) later. A push from a collision acts along the
/// heading; the tyres take the rest of it away.
pub(super) fn substep(vehicle: &Vehicle, motion: &mut Motion, controls: &Controls) {
    let forward = motion.body_forward();
    motion.seen_world = (motion.position.xy(), forward);
    // The speed of the rear axle.
    let before_mps = motion.velocity.xy().dot(&forward);
    let tan = controls.steer_sin / controls.steer_cos;
    // The centre is faster than the rear axle by this factor.
    let faster = 1f64.hypot(tan / 2.0);
    let change_mps = controls.accel_mps2 * SUBSTEP_S;
    let wanted_mps = match before_mps < 0.0 {
        // Pushed backwards, which the car does not drive: brake and engine stop it.
        true => (before_mps + change_mps.abs()).min(0.0),
        false => (before_mps + change_mps).max(0.0),
    };
    let speed_mps = wanted_mps.min(vehicle.max_speed_mps / faster);
    let asked_radps = speed_mps / vehicle.wheelbase_m * tan;
    let most_radps = vehicle.max_brake_mps2 / speed_mps.abs().max(f64::MIN_POSITIVE);
    let spin_radps = asked_radps.clamp(-most_radps, most_radps);
    // The velocity that holds on average over the sub-step, and the one at its end.
    let velocity_at = |share: f64| {
        let (sin, cos) = (spin_radps * SUBSTEP_S * share).sin_cos();
        let along = Vector::new(
            cos * forward.x - sin * forward.y,
            sin * forward.x + cos * forward.y,
        );
        let left = Vector::new(-along.y, along.x);
        let side_mps = spin_radps * vehicle.wheelbase_m / 2.0;
        (along, along * speed_mps + left * side_mps)
    };
    let moved = velocity_at(0.5).1 * SUBSTEP_S;
    let (along, velocity) = velocity_at(1.0);
    let along = along.normalize();
    motion.position = Vector3::new(
        motion.position.x + moved.x,
        motion.position.y + moved.y,
        0.0,
    );
    motion.axes = Matrix3::new(along.x, -along.y, 0.0, along.y, along.x, 0.0, 0.0, 0.0, 1.0);
    motion.velocity = Vector3::new(velocity.x, velocity.y, 0.0);
    motion.spin = Vector3::new(0.0, 0.0, spin_radps);
}
