//! The filters on motions that are known.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
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

/// A car within some 30 m that drives at a constant velocity is found to move,
/// that fast and that way; one that stands is found to rest, however the own car
/// moves. Not at every tick: what is seen of a body changes by leaps.
#[test]
fn tells_what_moves_from_what_rests() {
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut between = |low: f64, high: f64| {
        low + (dice.next_u64() >> 11) as f64 / (1u64 << 53) as f64 * (high - low)
    };
    let (mut seen_moving, mut right, mut seen_resting, mut alarms) = (0, 0, 0, 0);
    for _ in 0..100 {
        let away = pose(between(8.0, 25.0), between(-8.0, 8.0), between(-3.0, 3.0));
        let (speed, own_mps) = (between(5.0, 9.0), between(0.0, 8.0));
        let (mut moving, mut resting) = (Tracker::default(), Tracker::default());
        for tick in 0..20 {
            let passed_s = f64::from(tick) * STEP_S;
            let own = pose(own_mps * passed_s, 0.0, 0.0);
            let at = away * pose(speed * passed_s, 0.0, 0.0);
            moving.update(&seen(&own, &at), STEP_S);
            resting.update(&seen(&own, &away), STEP_S);
            if tick < 12 {
                continue;
            }
            let expected = away.rotation * Vector::new(speed, 0.0);
            for sighting in moving.sightings() {
                seen_moving += 1;
                right += u32::from((sighting.velocity_body - expected).norm() < 2.5);
            }
            seen_resting += resting.sightings().len();
            let moves = |sighting: &&Sighting| sighting.moves();
            alarms += resting.sightings().iter().filter(moves).count();
        }
    }
    println!("moving: {right} of {seen_moving} right; resting: {alarms} of {seen_resting} wrong");
    assert!(seen_moving > 1000 && seen_resting > 1000);
    assert!(
        f64::from(right) > 0.8 * f64::from(seen_moving),
        "{right} of {seen_moving}"
    );
    assert!(alarms * 50 < seen_resting, "{alarms} of {seen_resting}");
}

/// Which way a car turns is known within 0.25 rad/s, most of the time.
#[test]
fn tells_how_fast_what_moves_turns() {
    for turn_radps in [-0.5, 0.0, 0.5] {
        let (mut tracker, mut away_radps) = (Tracker::default(), Vec::new());
        for tick in 0..30 {
            let heading_rad = turn_radps * f64::from(tick) * STEP_S;
            // 6 m/s, first past (20, -8) to the left.
            let at = match turn_radps == 0.0 {
                true => pose(20.0, -8.0 + 6.0 * f64::from(tick) * STEP_S, 0.0),
                false => {
                    let radius_m = 6.0 / turn_radps;
                    let (sin, cos) = heading_rad.sin_cos();
                    pose(20.0 + radius_m * (cos - 1.0), -8.0 + radius_m * sin, 0.0)
                }
            };
            let heading = pose(0.0, 0.0, std::f64::consts::FRAC_PI_2 + heading_rad);
            tracker.update(&seen(&pose(0.0, 0.0, 0.0), &(at * heading)), STEP_S);
            if tick >= 15 {
                let moving = tracker
                    .sightings()
                    .iter()
                    .filter(|sighting| sighting.moves());
                away_radps.extend(moving.map(|sighting| (sighting.turn_radps - turn_radps).abs()));
            }
        }
        let near = away_radps.iter().filter(|away| **away < 0.25).count();
        assert!(away_radps.len() > 50);
        assert!(
            near * 10 > away_radps.len() * 7,
            "{turn_radps} rad/s: {near} of {}",
            away_radps.len()
        );
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
