//! What must hold of the car for every state and action, not for examples.

use proptest::prelude::*;
use vehicle::{Action, Footprint, Point, State, Vehicle, pose, step, wrap_rad};

const STEP_S: f64 = 0.1;

fn state() -> impl Strategy<Value = State> {
    (-1e3..1e3, -1e3..1e3, -3.1..3.1, 0.0..22.0).prop_map(|(x, y, heading_rad, speed_mps)| State {
        position: Point::new(x, y),
        heading_rad,
        speed_mps,
    })
}

fn action() -> impl Strategy<Value = Action> {
    (-1.0..=1.0, -1.0..=1.0).prop_map(|(steer, pedal)| Action { steer, pedal })
}

proptest! {
    #[test]
    fn wrapping_keeps_the_direction(angle_rad in -1e4..1e4f64) {
        let wrapped = wrap_rad(angle_rad);
        prop_assert!(wrapped > -std::f64::consts::PI && wrapped <= std::f64::consts::PI);
        prop_assert!((wrapped.sin() - angle_rad.sin()).abs() < 1e-9);
        prop_assert!((wrapped.cos() - angle_rad.cos()).abs() < 1e-9);
    }

    #[test]
    fn world_and_body_are_inverse(x in -1e3..1e3f64, y in -1e3..1e3f64, heading in -3.0..3.0f64,
                                  px in -50.0..50.0f64, py in -50.0..50.0f64) {
        let world_from_body = pose(x, y, heading);
        let point_body = Point::new(px, py);
        let back = world_from_body.inverse() * (world_from_body * point_body);
        prop_assert!((back - point_body).norm() < 1e-9);
    }

    #[test]
    fn action_survives_the_round_trip(action in action()) {
        let vehicle = Vehicle::default();
        let back = action.control(&vehicle).action(&vehicle);
        prop_assert!((back.steer - action.steer).abs() < 1e-12);
        prop_assert!((back.pedal - action.pedal).abs() < 1e-12);
    }

    #[test]
    fn left_and_right_are_mirrors(speed_mps in 0.0..22.0f64, action in action()) {
        let vehicle = Vehicle::default();
        let mirrored = Action { steer: -action.steer, ..action };
        let (mut left, mut right) = (State::at_origin(speed_mps), State::at_origin(speed_mps));
        for _ in 0..20 {
            left = step(&vehicle, &left, action.control(&vehicle), STEP_S);
            right = step(&vehicle, &right, mirrored.control(&vehicle), STEP_S);
        }
        prop_assert!((left.position.x - right.position.x).abs() < 1e-9);
        prop_assert!((left.position.y + right.position.y).abs() < 1e-9);
        prop_assert!(wrap_rad(left.heading_rad + right.heading_rad).abs() < 1e-9);
        if action.steer > 0.01 && speed_mps > 1.0 && action.pedal >= 0.0 {
            prop_assert!(left.heading_rad != 0.0, "positive steer must turn");
        }
    }

    #[test]
    fn only_the_pedal_adds_energy(state in state(), action in action()) {
        let vehicle = Vehicle::default();
        let after = step(&vehicle, &state, action.control(&vehicle), STEP_S);
        prop_assert!(after.speed_mps >= 0.0);
        if action.pedal <= 0.0 {
            prop_assert!(after.speed_mps <= state.speed_mps);
        }
        let moved_m = (after.position - state.position).norm();
        prop_assert!((moved_m - STEP_S * state.speed_mps).abs() < 1e-9);
    }

    #[test]
    fn footprint_distance_agrees_with_its_corners(x in -9.0..9.0f64, y in -9.0..9.0f64, heading in -3.0..3.0f64) {
        let footprint = Footprint { length_m: 4.515, width_m: 1.852 };
        let world_from_body = pose(x, y, heading);
        for corner_world in footprint.corners(&world_from_body) {
            let corner_body = world_from_body.inverse() * corner_world;
            prop_assert!(footprint.distance_m(corner_body).abs() < 1e-9);
        }
        // Brute force: the nearest of many points on the outline.
        let point_body = Point::new(x, y);
        let nearest_m = (0..40_000)
            .map(|k| {
                let (side, t) = (k / 10_000, f64::from(k % 10_000) / 10_000.0);
                let c = footprint.corners(&pose(0.0, 0.0, 0.0));
                let (a, b) = (c[side as usize], c[(side as usize + 1) % 4]);
                (a + (b - a) * t - point_body).norm()
            })
            .fold(f64::INFINITY, f64::min);
        prop_assert!((footprint.distance_m(point_body).abs() - nearest_m).abs() < 1e-3);
    }
}

#[test]
fn positive_steer_turns_left() {
    let vehicle = Vehicle::default();
    let action = Action {
        steer: 0.5,
        pedal: 0.0,
    };
    let mut state = State::at_origin(5.0);
    for _ in 0..10 {
        state = step(&vehicle, &state, action.control(&vehicle), STEP_S);
    }
    assert!(state.heading_rad > 0.1 && state.position.y > 0.1);
}

#[test]
fn one_step_is_equations_3_to_6() {
    let vehicle = Vehicle::default();
    let state = State {
        position: Point::new(1.0, 2.0),
        heading_rad: 0.3,
        speed_mps: 4.0,
    };
    let control = Action {
        steer: 0.25,
        pedal: 0.5,
    }
    .control(&vehicle);
    let next = step(&vehicle, &state, control, STEP_S);
    assert!((next.position.x - (1.0 + 0.1 * 4.0 * 0.3f64.cos())).abs() < 1e-12);
    assert!((next.position.y - (2.0 + 0.1 * 4.0 * 0.3f64.sin())).abs() < 1e-12);
    let yaw = 0.3 + 0.1 * 4.0 / 2.469 * 10f64.to_radians().tan();
    assert!((next.heading_rad - yaw).abs() < 1e-12);
    assert!((next.speed_mps - (4.0 + 0.1 * 0.5 * 2.76)).abs() < 1e-12);
}

#[test]
fn non_finite_actions_brake() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(
            Action {
                steer: bad,
                pedal: 1.0
            }
            .clamped(),
            Action::BRAKE
        );
        assert_eq!(
            Action {
                steer: 0.0,
                pedal: bad
            }
            .clamped(),
            Action::BRAKE
        );
    }
}

#[test]
fn impossible_cars_are_refused_by_name() {
    for (change, name) in [
        (
            Vehicle {
                wheelbase_m: 0.0,
                ..Vehicle::default()
            },
            "wheelbase_m",
        ),
        (
            Vehicle {
                width_m: f64::NAN,
                ..Vehicle::default()
            },
            "width_m",
        ),
        (
            Vehicle {
                max_steer_deg: 90.0,
                ..Vehicle::default()
            },
            "max_steer_deg",
        ),
    ] {
        assert_eq!(change.validated().unwrap_err().name, name);
    }
}
