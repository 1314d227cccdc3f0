//! Verdicts in the tick against brute force.

use proptest::prelude::*;
use safety::{RoadAhead, Scene, assess};
use shm_config::config::JudgeLimits;
use shm_config::message::{Bend, Observation, Verdict};
use vehicle::{Action, Point, State, Vehicle, step};

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
        let (vehicle, limits) = (Vehicle::default(), JudgeLimits::default());
        let mut observation = observation(speed_mps);
        for (beam, range_m) in &returns {
            observation.ranges_m[*beam] = *range_m;
        }
        let action = Action { steer, pedal };
        let scene = Scene::new(&observation, Scene::reach_m(&vehicle, &limits, speed_mps));
        let measured = assess(&vehicle, &limits, &scene, Some(action));

        let control = action.control(&vehicle);
        let mut state = State::at_origin(speed_mps);
        let mut first_s = None;
        for k in 1..=15 {
            state = step(&vehicle, &state, control, 0.1);
            let body = state.pose().inverse();
            let hits = returns.iter().any(|(beam, _)| {
                let range_m = f64::from(observation.ranges_m[*beam]);
                let angle = (*beam as f64 * 1.5).to_radians();
                let p = body * Point::new(range_m * angle.cos(), range_m * angle.sin());
                let (dx, dy) = (p.x.abs() - vehicle.length_m / 2.0, p.y.abs() - vehicle.width_m / 2.0);
                dx.max(0.0).hypot(dy.max(0.0)) < limits.margin_m && dx.max(dy) < limits.margin_m
            }) && state.speed_mps > 0.0;
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
