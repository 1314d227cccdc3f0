//! The filters on motions that are known.

use proptest::prelude::*;
use shm_config::message::{Ego, Observation};
use vehicle::{Action, Footprint, Vehicle, pose};

use super::*;

const STEP_S: f64 = 0.1;
const CAR: Footprint = Footprint {
    length_m: 4.6,
    width_m: 1.85,
};

/// What a car at a pose sees of another one, by walking along each beam.
fn seen(world_from_body: &Pose, world_from_other: &Pose) -> Observation {
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    let ego = &mut observation.ego;
    let at = world_from_body.translation.vector;
    (ego.x_world_m, ego.y_world_m) = (at.x, at.y);
    ego.heading_world_rad = world_from_body.rotation.angle();
    let other_from_body = world_from_other.inverse() * world_from_body;
    for (beam, range_m) in observation.ranges_m[..240].iter_mut().enumerate() {
        let (sin, cos) = (beam as f64 * 1.5_f64.to_radians()).sin_cos();
        let hit = (1..500).map(|step| f64::from(step) * 0.1).find(|&away_m| {
            CAR.distance_m(other_from_body * Point::new(cos * away_m, sin * away_m)) <= 0.0
        });
        *range_m = hit.unwrap_or(50.0) as f32;
    }
    observation
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// A car that drives past at a constant velocity is found to move, that fast
    /// and that way; one that stands is found to rest, however the own car moves.
    #[test]
    fn tells_what_moves_from_what_rests(
        x in 8.0..25.0f64,
        y in -8.0..8.0f64,
        heading in -3.0..3.0f64,
        speed in 5.0..9.0f64,
        own_mps in 0.0..8.0f64,
    ) {
        let (mut moving, mut resting) = (Tracker::default(), Tracker::default());
        for tick in 0..15 {
            let passed_s = f64::from(tick) * STEP_S;
            let own = pose(own_mps * passed_s, 0.0, 0.0);
            let away = pose(x + 12.0, y, heading);
            let at = away * pose(speed * passed_s, 0.0, 0.0);
            moving.update(&seen(&own, &at), STEP_S);
            resting.update(&seen(&own, &away), STEP_S);
        }
        let sighted = |tracker: &Tracker| -> Vec<Vector> {
            tracker.sightings().iter().map(|sighting| sighting.velocity_body).collect()
        };
        let expected = Vector::new(heading.cos(), heading.sin()) * speed;
        for velocity in sighted(&moving) {
            prop_assert!((velocity - expected).norm() < 2.5, "{velocity:?} {expected:?}");
        }
        for velocity in sighted(&resting) {
            prop_assert!(velocity.norm() < 3.0, "{velocity:?}");
        }
    }
}

/// An engine and a steering stronger than the model's are found out.
#[test]
fn learns_the_gains_of_engine_and_steering() {
    let vehicle = Vehicle::default();
    let (engine, steering) = (1.15, 0.9);
    let mut ego = Ego {
        speed_mps: 2.0,
        ..Ego::default()
    };
    let mut filter = EgoFilter::new(&ego);
    let keep = (-STEP_S / YAW_LAG_S).exp();
    for tick in 0..60 {
        let action = Action {
            steer: 0.3 * (f64::from(tick) * 0.2).sin(),
            pedal: 0.6,
        };
        let control = action.control(&vehicle);
        let wanted = steering * ego.speed_mps * control.steer_rad.tan() / vehicle.wheelbase_m;
        ego.yaw_rate_radps = keep * ego.yaw_rate_radps + (1.0 - keep) * wanted;
        ego.speed_mps += STEP_S * engine * control.accel_mps2;
        (ego.steer, ego.pedal) = (action.steer, action.pedal);
        filter.update(&ego, &vehicle, STEP_S);
    }
    assert!(
        (filter.engine_gain() - engine).abs() < 0.03,
        "{}",
        filter.engine_gain()
    );
    assert!(
        (filter.steering_gain() - steering).abs() < 0.05,
        "{}",
        filter.steering_gain()
    );
    assert!((filter.speed_mps() - ego.speed_mps).abs() < 0.05);
    assert!((filter.yaw_rate_radps() - ego.yaw_rate_radps).abs() < 0.02);
}
