//! Verdicts in the tick against brute force.

use proptest::prelude::*;
use safety::{RoadAhead, Scene, assess};
use shm_config::config::SafetyLimits;
use shm_config::message::{Bend, Observation, Verdict};
use vehicle::{Action, Point, Scanner, State, Vehicle, step};

fn observation(speed_mps: f64) -> Observation {
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.header.taken_ns = 1;
    observation.ranges_m.fill(50.0);
    observation.road.left_m = 5.25;
    observation.road.right_m = 5.25;
    observation.ego.speed_mps = speed_mps;
    observation.checkpoints[0].x_body_m = 40.0;
    observation
}

proptest! {
    /// A dense, obviously right rollout against every return.
    #[test]
    fn verdicts_agree_with_brute_force(
        speed_mps in 0.0..15.0f64, steer in -1.0..1.0f64, pedal in -1.0..1.0f64,
        returns in prop::collection::vec((0usize..240, 2.5f32..30.0), 0..12),
    ) {
        let (vehicle, limits) = (Vehicle::default(), SafetyLimits::default());
        let mut observation = observation(speed_mps);
        for (beam, range_m) in &returns {
            observation.ranges_m[*beam] = *range_m;
        }
        let action = Action { steer, pedal };
        let scene = Scene::new(&observation, Scene::reach_m(&vehicle, &limits, speed_mps));
        let measured = assess(&vehicle, &limits, &scene, Some(action));

        let control = action.control(&vehicle);
        let clearance_m = |state: &State| {
            let body = state.pose().inverse();
            let away = returns.iter().map(|(beam, _)| {
                let range_m = f64::from(observation.ranges_m[*beam]);
                let angle = (*beam as f64 * 1.5).to_radians();
                let p = body * Point::new(range_m * angle.cos(), range_m * angle.sin());
                let (dx, dy) = (p.x.abs() - vehicle.length_m / 2.0, p.y.abs() - vehicle.width_m / 2.0);
                match dx.max(dy) < 0.0 {
                    true => dx.max(dy),
                    false => dx.max(0.0).hypot(dy.max(0.0)),
                }
            });
            away.fold(f64::INFINITY, f64::min)
        };
        let mut state = State::at_origin(speed_mps);
        // Within the margin a car that creeps may go on, and come no nearer.
        let now_m = clearance_m(&state);
        let least_m = match now_m < limits.margin_m && speed_mps < 1.0 {
            true => (now_m - 0.001).max(0.0),
            false => limits.margin_m,
        };
        let mut first_s = None;
        for k in 1..=15 {
            state = step(&vehicle, &state, control, 0.1);
            let hits = clearance_m(&state) < least_m && state.speed_mps > 0.0;
            let leaves = vehicle.footprint().corners(&state.pose()).iter().any(|c| c.y.abs() > 5.45);
            if hits || leaves {
                first_s = Some((f64::from(k) * 0.1, if hits { Verdict::Hits } else { Verdict::Leaves }));
                break;
            }
        }
        match first_s {
            None => prop_assert_eq!(measured.verdict(), Verdict::Clear),
            Some((safe_s, verdict)) => {
                prop_assert_eq!(measured.verdict(), verdict);
                prop_assert!((measured.safe_s - safe_s).abs() < 1e-9);
                let stopping_s = speed_mps / vehicle.max_brake_mps2 + limits.reaction_s;
                prop_assert_eq!(measured.is_vetoed(), safe_s <= stopping_s);
            }
        }
    }

    /// Points walked along an arc keep their offset; the edges are where they are.
    #[test]
    fn bends_are_followed(radius_m in 20.0..60.0f64, along_m in -10.0..10.0f64, offset_m in -4.0..4.0f64, left in any::<bool>()) {
        let mut observation = observation(5.0);
        let checkpoint = &mut observation.checkpoints[0];
        checkpoint.bend = if left { Bend::Left } else { Bend::Right }.code();
        checkpoint.bend_radius_m = radius_m;
        let side = if left { 1.0 } else { -1.0 };
        // The car's own track has this radius: the leftmost lane's centre is 3.5 m to its left.
        let track_m = radius_m + side * 3.5;
        let angle = along_m / track_m;
        let r = track_m - side * offset_m;
        let point = Point::new(r * angle.sin(), side * (track_m - r * angle.cos()));
        let road = RoadAhead::new(&observation);
        prop_assert!((road.offset_m(point) - offset_m).abs() < 1e-9);
        prop_assert!((road.edge_m(point) - (5.25 - offset_m.abs())).abs() < 1e-9);
    }
}

/// The verdict on a free road, by what this scanner sees of it.
fn seen_by(
    scanner: &Scanner,
    vehicle: &Vehicle,
    action: Action,
) -> shm_config::message::Assessment {
    let mut observation = observation(6.0);
    observation.set_fan(&scanner.fan());
    let limits = SafetyLimits::default();
    let scene = Scene::new(&observation, Scene::reach_m(vehicle, &limits, 6.0));
    assess(vehicle, &limits, &scene, Some(action))
}

#[test]
fn the_front_does_not_enter_what_no_beam_sees() {
    let ahead = Action {
        steer: 0.0,
        pedal: 0.2,
    };
    let car = Vehicle::default();
    let scanner = |field_of_view_deg: f64, heading_deg: f64| Scanner {
        field_of_view_deg,
        heading_deg,
        x_m: 2.0,
        ..Scanner::default()
    };
    assert_eq!(
        seen_by(&scanner(360.0, 0.0), &car, ahead).verdict(),
        Verdict::Clear
    );
    assert_eq!(
        seen_by(&scanner(270.0, 0.0), &car, ahead).verdict(),
        Verdict::Clear
    );
    let blind = seen_by(&scanner(180.0, 180.0), &car, ahead);
    assert_eq!(blind.verdict(), Verdict::Hits);
    assert!(blind.is_vetoed(), "nothing says that the road is free");
    // A wedge straight ahead that lies between the corners of the front.
    let wedge = seen_by(&scanner(340.0, 180.0), &car, ahead);
    assert_eq!(wedge.verdict(), Verdict::Hits);
    // From the rear, 60 degrees see a straight lane but not what a sharp turn leads into.
    let narrow = Scanner {
        x_m: -2.0,
        ..scanner(60.0, 0.0)
    };
    let turn = Action {
        steer: 1.0,
        pedal: 0.0,
    };
    assert_eq!(seen_by(&narrow, &car, ahead).verdict(), Verdict::Clear);
    assert_eq!(seen_by(&narrow, &car, turn).verdict(), Verdict::Hits);
}

#[test]
fn without_a_beam_the_car_stands() {
    let car = Vehicle::default();
    let dead = Scanner {
        beams: 0,
        ..Scanner::default()
    };
    let ahead = Action {
        steer: 0.0,
        pedal: 0.2,
    };
    let driving = seen_by(&dead, &car, ahead);
    assert_eq!(driving.verdict(), Verdict::Hits);
    assert!(driving.is_vetoed(), "while it drives");
    let mut observation = observation(0.0);
    observation.set_fan(&dead.fan());
    let limits = SafetyLimits::default();
    let scene = Scene::new(&observation, Scene::reach_m(&car, &limits, 0.0));
    let standing = |action| assess(&car, &limits, &scene, Some(action));
    assert!(standing(ahead).is_vetoed(), "when it sets off");
    assert_eq!(standing(Action::BRAKE).verdict(), Verdict::Clear);
}

#[test]
fn returns_are_where_the_scanner_is() {
    let vehicle = Vehicle::default();
    let limits = SafetyLimits::default();
    let clearance_m = |x_m: f64| {
        let scanner = Scanner {
            beams: 3,
            field_of_view_deg: 180.0,
            x_m,
            ..Scanner::default()
        };
        let mut observation = observation(0.0);
        observation.set_fan(&scanner.fan());
        observation.ranges_m[1] = 3.0;
        let scene = Scene::new(&observation, Scene::reach_m(&vehicle, &limits, 0.0));
        let stand = Action {
            steer: 0.0,
            pedal: -1.0,
        };
        assess(&vehicle, &limits, &scene, Some(stand)).clearance_m
    };
    assert!((clearance_m(0.0) - (3.0 - vehicle.length_m / 2.0)).abs() < 1e-9);
    assert!((clearance_m(1.0) - (4.0 - vehicle.length_m / 2.0)).abs() < 1e-9);
}

#[test]
fn a_delay_makes_the_veto_earlier() {
    let mut observation = observation(10.0);
    observation.ranges_m[0] = 13.0;
    let limits = SafetyLimits::default();
    let vetoed = |delay_ms: f64| {
        let vehicle = Vehicle {
            delay_ms,
            ..Vehicle::default()
        };
        let scene = Scene::new(&observation, Scene::reach_m(&vehicle, &limits, 10.0));
        let ahead = Action {
            steer: 0.0,
            pedal: 0.0,
        };
        assess(&vehicle, &limits, &scene, Some(ahead)).is_vetoed()
    };
    // A contact in 1.1 s; the brake takes 0.85 s and the reaction 0.2 s.
    assert!(!vetoed(0.0) && vetoed(300.0));
}

/// The verdict on a car that drives straight on at this speed with a return beside it.
fn beside_an_obstacle(speed_mps: f64, steer: f64, away_m: f64) -> Verdict {
    let (vehicle, limits) = (Vehicle::default(), SafetyLimits::default());
    let mut observation = observation(speed_mps);
    observation.ranges_m[60] = (vehicle.width_m / 2.0 + away_m) as f32;
    let scene = Scene::new(&observation, Scene::reach_m(&vehicle, &limits, speed_mps));
    let action = Action { steer, pedal: 0.3 };
    assess(&vehicle, &limits, &scene, Some(action)).verdict()
}

#[test]
fn a_car_within_the_margin_may_creep_on_and_come_no_nearer() {
    assert_eq!(beside_an_obstacle(0.0, 0.0, 0.1), Verdict::Clear);
    assert_eq!(beside_an_obstacle(0.9, 0.0, 0.1), Verdict::Clear);
    assert_eq!(beside_an_obstacle(2.0, 0.0, 0.1), Verdict::Hits);
    // To the right its rear swings to the left.
    assert_eq!(beside_an_obstacle(0.9, -1.0, 0.1), Verdict::Hits);
    assert_eq!(beside_an_obstacle(2.0, 0.0, 0.2), Verdict::Clear);
}
