//! The filters on motions that are known.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use shm_config::message::{Ego, Observation};
use vehicle::{Action, Footprint, Vehicle, pose};

use super::*;
use crate::{EgoFilter, YAW_LAG_S};

const STEP_S: f64 = 0.1;
const CAR: Footprint = Footprint {
    length_m: 4.6,
    width_m: 1.85,
};

/// How far along a ray a rectangle around the origin is; `None` when it is missed.
fn range_m(shape: &Footprint, from: Point, direction: Vector) -> Option<f64> {
    let half_m = [shape.length_m / 2.0, shape.width_m / 2.0];
    let (mut first_m, mut last_m) = (0.0, f64::INFINITY);
    for axis in 0..2 {
        let at = |side: f64| (side * half_m[axis] - from[axis]) / direction[axis];
        first_m = at(-1.0).min(at(1.0)).max(first_m);
        last_m = at(-1.0).max(at(1.0)).min(last_m);
    }
    (first_m <= last_m).then_some(first_m)
}

/// What a car at a pose sees of bodies.
fn seen(world_from_body: &Pose, bodies: &[(Pose, Footprint)]) -> Observation {
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    let ego = &mut observation.ego;
    let at = world_from_body.translation.vector;
    (ego.x_world_m, ego.y_world_m) = (at.x, at.y);
    ego.heading_world_rad = world_from_body.rotation.angle();
    let scanner = world_from_body * observation.fan().mount_body;
    for beam in 0..240 {
        let direction = world_from_body.rotation * observation.fan().direction_body(beam);
        let ranges = bodies.iter().filter_map(|(at, shape)| {
            let (from, along) = (at.inverse() * scanner, at.rotation.inverse() * direction);
            range_m(shape, from, along)
        });
        observation.ranges_m[beam] = ranges.fold(50.0, f64::min) as f32;
    }
    observation
}

/// The velocity that most returns within a body's outline were given; `None` without any.
fn velocity_of(tracker: &Tracker, world_from_body: &Pose, at: &Pose) -> Option<Vector> {
    let body_from_other = world_from_body.inverse() * at;
    let is_its = |sighting: &&Sighting| {
        CAR.distance_m(body_from_other.inverse() * sighting.point_body) < 0.2
    };
    let its: Vec<&Sighting> = tracker.sightings().iter().filter(is_its).collect();
    let moving = its.iter().filter(|sighting| sighting.moves()).count();
    let wanted = 2 * moving > its.len();
    let one = its.iter().find(|sighting| sighting.moves() == wanted)?;
    Some(world_from_body.rotation * one.velocity_body)
}

/// A car within some 30 m that drives at a constant velocity is found to move, that fast and
/// that way, within 1 m/s; one that stands is found to rest, however the own car moves.
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
            // One that would be driven through is not followed any more.
            if CAR.distance_m(at.inverse() * Point::from(own.translation.vector)) < 2.5 {
                break;
            }
            moving.update(&seen(&own, &[(at, CAR)]), STEP_S);
            resting.update(&seen(&own, &[(away, CAR)]), STEP_S);
            if tick < 10 {
                continue;
            }
            let expected = away.rotation * Vector::new(speed, 0.0);
            if let Some(velocity) = velocity_of(&moving, &own, &at) {
                seen_moving += 1;
                right += u32::from((velocity - expected).norm() < 1.0);
            }
            seen_resting += resting.sightings().len();
            let moves = |sighting: &&Sighting| sighting.moves();
            alarms += resting.sightings().iter().filter(moves).count();
        }
    }
    println!("moving: {right} of {seen_moving} right; resting: {alarms} of {seen_resting} wrong");
    assert!(seen_moving > 500 && seen_resting > 1000);
    assert!(
        f64::from(right) > 0.9 * f64::from(seen_moving),
        "{right} of {seen_moving}"
    );
    assert!(alarms * 200 < seen_resting, "{alarms} of {seen_resting}");
}

/// Two cars side by side, a lane apart, are two bodies, and move; one that comes towards the
/// own car and passes it is followed all the way.
#[test]
fn follows_cars_beside_each_other_and_past_the_own_one() {
    let mut tracker = Tracker::default();
    let mut found = Vec::new();
    for tick in 0..40 {
        let passed_s = f64::from(tick) * STEP_S;
        let own = pose(5.0 * passed_s, 0.0, 0.0);
        let along = |x: f64, y: f64, mps: f64| {
            let heading_rad = if mps < 0.0 { std::f64::consts::PI } else { 0.0 };
            pose(x + mps * passed_s, y, heading_rad)
        };
        let cars = [
            (along(14.0, 0.0, 6.0), Vector::new(6.0, 0.0)),
            (along(15.0, 3.5, 7.0), Vector::new(7.0, 0.0)),
            (along(20.0, -5.0, -4.0), Vector::new(-4.0, 0.0)),
        ];
        let bodies = cars.map(|(at, _)| (at, CAR));
        tracker.update(&seen(&own, &bodies), STEP_S);
        if tick >= 8 {
            found.extend(cars.iter().filter_map(|(at, expected)| {
                let velocity = velocity_of(&tracker, &own, at)?;
                Some((velocity - expected).norm())
            }));
        }
    }
    let right = found.iter().filter(|off_mps| **off_mps < 0.7).count();
    assert!(found.len() > 80);
    assert!(right * 20 > found.len() * 19, "{right} of {}", found.len());
}

/// A row of cones and a row of parked cars that are passed come into view and out of it, one
/// behind the other: nothing moves.
#[test]
fn what_comes_into_view_does_not_move() {
    let cone = Footprint {
        length_m: 0.4,
        width_m: 0.4,
    };
    let (mut sightings, mut alarms) = (0, 0);
    for own_mps in [3.0, 6.0, 9.0] {
        let mut tracker = Tracker::default();
        let cones = (0..12).map(|index| {
            let along_m = f64::from(index) * 2.0;
            (pose(15.0 + along_m, -2.0 + 0.3 * along_m, 0.0), cone)
        });
        let parked = (0..5).map(|index| (pose(10.0 + 6.5 * f64::from(index), -4.5, 0.0), CAR));
        let bodies: Vec<(Pose, Footprint)> = cones.chain(parked).collect();
        for tick in 0..50 {
            let own = pose(own_mps * f64::from(tick) * STEP_S, 0.0, 0.0);
            tracker.update(&seen(&own, &bodies), STEP_S);
            sightings += tracker.sightings().len();
            let moves = |sighting: &&Sighting| sighting.moves();
            alarms += tracker.sightings().iter().filter(moves).count();
        }
    }
    println!("{alarms} of {sightings} wrong");
    assert!(sightings > 3000);
    assert!(alarms * 200 < sightings, "{alarms} of {sightings}");
}

/// What is forgotten shows no motion: the first scan of an episode is not compared with the
/// last one's.
#[test]
fn an_episode_begins_without_a_past() {
    let mut tracker = Tracker::default();
    for tick in 0..10 {
        let at = pose(20.0 + 0.7 * f64::from(tick), 0.0, 0.0);
        tracker.update(&seen(&Pose::identity(), &[(at, CAR)]), STEP_S);
    }
    assert!(tracker.sightings().iter().any(Sighting::moves));
    tracker.forget();
    for _ in 0..10 {
        let at = pose(15.0, 0.0, 0.0);
        tracker.update(&seen(&Pose::identity(), &[(at, CAR)]), STEP_S);
        assert!(!tracker.sightings().iter().any(Sighting::moves));
    }
}

/// How fast a car turns is known within 0.25 rad/s, half of the time.
#[test]
fn tells_how_fast_what_moves_turns() {
    for turn_radps in [-0.5, 0.0, 0.5] {
        let (mut tracker, mut away_radps) = (Tracker::default(), Vec::new());
        for tick in 0..30 {
            let heading_rad = turn_radps * f64::from(tick) * STEP_S;
            // 6 m/s, first past (14, -8) to the left.
            let at = match turn_radps == 0.0 {
                true => pose(14.0, -8.0 + 6.0 * f64::from(tick) * STEP_S, 0.0),
                false => {
                    let radius_m = 6.0 / turn_radps;
                    let (sin, cos) = heading_rad.sin_cos();
                    pose(14.0 + radius_m * (cos - 1.0), -8.0 + radius_m * sin, 0.0)
                }
            };
            let heading = pose(0.0, 0.0, std::f64::consts::FRAC_PI_2 + heading_rad);
            tracker.update(&seen(&Pose::identity(), &[(at * heading, CAR)]), STEP_S);
            if tick >= 15 {
                let moving = tracker
                    .sightings()
                    .iter()
                    .filter(|sighting| sighting.moves());
                away_radps.extend(moving.map(|sighting| (sighting.turn_radps - turn_radps).abs()));
            }
        }
        away_radps.sort_by(f64::total_cmp);
        assert!(away_radps.len() > 50);
        let median_radps = away_radps[away_radps.len() / 2];
        assert!(
            median_radps < 0.25,
            "{turn_radps} rad/s: off by {median_radps}"
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

/// A car ahead that drives away at 8 m/s is told in the sector ahead, and nothing elsewhere.
#[test]
fn a_policy_is_told_the_velocity_of_the_nearest_return_of_each_sector() {
    let mut tracker = Tracker::default();
    let own = pose(0.0, 0.0, 0.0);
    for tick in 0..15 {
        let at = pose(12.0 + 0.8 * f64::from(tick), 0.0, 0.0);
        let resting = pose(0.0, 15.0, 0.0);
        let mut observation = seen(&own, &[(at, CAR), (resting, CAR)]);
        observation.header.taken_ns = tick as u64 * 100_000_000;
        tracker.follow(&observation);
        // The same one again changes nothing.
        let sightings = tracker.sightings().to_vec();
        tracker.follow(&observation);
        assert_eq!(tracker.sightings(), sightings);
    }
    let motion = tracker.motion();
    assert!((motion[0] - 0.7).abs() < 0.03, "{}", motion[0]);
    assert!((motion[1] - 0.5).abs() < 0.02, "{}", motion[1]);
    let ahead = |sector: usize| (1..MOTION_FEATURES / 2 - 1).contains(&sector);
    for sector in (0..MOTION_FEATURES / 2).filter(|sector| ahead(*sector)) {
        assert_eq!(
            motion[2 * sector..2 * sector + 2],
            [MOTION_AT_REST; 2],
            "{sector}"
        );
    }
}

/// What is known to move keeps its velocity over ground in a scan from another pose.
#[test]
fn a_single_scan_takes_the_motion_that_is_known() {
    let mut tracker = Tracker::default();
    let mut last = Observation::default();
    let at = |tick: i32| pose(12.0 + 0.8 * f64::from(tick), 0.0, 0.0);
    for tick in 0..15 {
        last = seen(&pose(0.0, 0.0, 0.0), &[(at(tick), CAR)]);
        last.header.taken_ns = tick as u64 * 100_000_000;
        tracker.follow(&last);
    }
    let moving: Vec<Moving> = tracker.moving(&last).collect();
    assert!(!moving.is_empty());
    // From a little to the left, turned to the left by a quarter: it drives to the right.
    let turned = pose(0.0, 0.5, std::f64::consts::FRAC_PI_2);
    let mut there = Tracker::default();
    there.suppose(&seen(&turned, &[(at(14), CAR)]), &moving);
    let moves: Vec<&Sighting> = there.sightings().iter().filter(|one| one.moves()).collect();
    assert!(!moves.is_empty());
    for sighting in moves {
        let off = sighting.velocity_body - Vector::new(0.0, -8.0);
        assert!(off.norm() < 1.0, "{}", sighting.velocity_body);
    }
    there.suppose(&last, &[]);
    assert!(there.sightings().iter().all(|one| !one.moves()));
}
