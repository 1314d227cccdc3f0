//! Tests of the networks' input: mirroring, and the linear change that is folded into a
//! policy file.

use learner::export;
use learner::features::{convolutions, mirror, mirror_action, prepare};
use learner::network::{Head, Network, Tape};
use learner::replay::INPUTS;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use shm_config::message::{Bend, FEATURES, INPUTS_WITH_MOTION, Observation};

/// Features are f32 in [0, 1] and change at most twice.
const TOLERANCE: f32 = 1e-6;
/// Width of a lane of the built-in world, m.
const LANE_M: f64 = 3.5;

fn assert_near(a: &[f32], b: &[f32], what: &str) {
    for (feature, (a, b)) in a.iter().zip(b).enumerate() {
        assert!(
            (a - b).abs() <= TOLERANCE,
            "{what}, feature {feature}: {a} and {b}"
        );
    }
}

/// A scene on a road of three lanes, made from a seed.
fn scene(seed: u64) -> Observation {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    let left_m = random.random_range(1.0..9.5);
    observation.road.left_m = left_m;
    observation.road.right_m = 3.0 * LANE_M - left_m;
    observation.road.heading_rad = random.random_range(-1.0..1.0);
    observation.road.offset_m = random.random_range(-2.0..2.0);
    observation.ego.speed_mps = random.random_range(0.0..20.0);
    observation.ego.yaw_rate_radps = random.random_range(-0.9..0.9);
    observation.ego.steer = random.random_range(-1.0..1.0);
    observation.ego.pedal = random.random_range(-1.0..1.0);
    for checkpoint in &mut observation.checkpoints {
        checkpoint.x_body_m = random.random_range(-60.0..60.0);
        checkpoint.y_body_m = random.random_range(-60.0..60.0);
        let bend = [Bend::Straight, Bend::Left, Bend::Right][random.random_range(0..3)];
        checkpoint.bend = bend.code();
        if bend != Bend::Straight {
            // The radius of the leftmost lane, the outer one of a bend to the right.
            let inner_m = random.random_range(25.0..60.0);
            let across_m = if bend == Bend::Right {
                2.0 * LANE_M
            } else {
                0.0
            };
            checkpoint.bend_radius_m = inner_m + across_m;
            checkpoint.bend_angle_rad = random.random_range(0.3..2.0);
        }
    }
    for range_m in &mut observation.ranges_m[..240] {
        *range_m = random.random_range(0.0..50.0);
    }
    observation
}

/// The same scene with left and right exchanged.
fn mirrored(scene: &Observation) -> Observation {
    let mut mirrored = *scene;
    mirrored.road.left_m = scene.road.right_m;
    mirrored.road.right_m = scene.road.left_m;
    mirrored.road.heading_rad = -scene.road.heading_rad;
    mirrored.road.offset_m = -scene.road.offset_m;
    mirrored.ego.yaw_rate_radps = -scene.ego.yaw_rate_radps;
    mirrored.ego.steer = -scene.ego.steer;
    for checkpoint in &mut mirrored.checkpoints {
        checkpoint.y_body_m = -checkpoint.y_body_m;
        // The rightmost lane becomes the leftmost one.
        let (bend, across_m) = match checkpoint.bend() {
            Bend::Straight => (Bend::Straight, 0.0),
            Bend::Left => (Bend::Right, 2.0 * LANE_M),
            Bend::Right => (Bend::Left, -2.0 * LANE_M),
        };
        checkpoint.bend = bend.code();
        checkpoint.bend_radius_m += across_m;
    }
    for beam in 1..240 {
        mirrored.ranges_m[beam] = scene.ranges_m[240 - beam];
    }
    mirrored
}

fn features(observation: &Observation) -> [f32; FEATURES] {
    let mut features = [0.0; FEATURES];
    observation.features(&mut features).expect("240 beams");
    features
}

#[test]
fn mirrored_features_are_those_of_the_mirrored_scene() {
    for seed in 0..200 {
        let scene = scene(seed);
        let mut row = features(&scene);
        mirror(&mut row);
        assert_near(&row, &features(&mirrored(&scene)), &format!("seed {seed}"));
    }
}

#[test]
fn the_mirror_of_the_mirror_is_the_scene() {
    for seed in 0..200 {
        let row = features(&scene(seed));
        let mut twice = row;
        mirror(&mut twice);
        assert_ne!(twice, row, "seed {seed}: mirroring changes nothing");
        mirror(&mut twice);
        assert_near(&twice, &row, &format!("seed {seed}"));
    }
    let mut action = [0.25, -0.5];
    mirror_action(&mut action);
    assert_eq!(action, [-0.25, -0.5]);
    mirror_action(&mut action);
    assert_eq!(action, [0.25, -0.5]);
}

#[test]
fn a_mirrored_velocity_is_on_the_other_side_and_goes_to_the_other_side() {
    let mut row = [0.0; INPUTS];
    row[..FEATURES].copy_from_slice(&features(&scene(1)));
    row[FEATURES..].fill(0.5);
    // A car 12 degrees to the left drives ahead and to the left.
    let [left, right] = [2, 58].map(|sector| FEATURES + 2 * sector);
    (row[left], row[left + 1]) = (0.8, 0.6);
    let mut mirrored = row;
    mirror(&mut mirrored);
    assert_near(&mirrored[right..right + 2], &[0.8, 0.4], "the other side");
    assert_near(&mirrored[left..left + 2], &[0.5, 0.5], "its own side");
    mirror(&mut mirrored);
    assert_near(&mirrored, &row, "twice");
    // What rests is zero for the networks, and 5 m/s are one.
    let mut prepared = row;
    prepare(&mut prepared);
    assert_near(&prepared[left..left + 2], &[2.4, 0.8], "12 and 4 m/s");
    assert_near(&prepared[right..right + 2], &[0.0, 0.0], "at rest");
}

#[test]
fn a_beam_counts_most_where_something_is_near() {
    let near = |feature: f32| {
        let mut row = [feature; FEATURES];
        prepare(&mut row);
        row[FEATURES - 1]
    };
    // In 50 m: at the obstacle, 2.5 m away, and where nothing is in range.
    for (feature, expected) in [(0.0, 2.0), (0.05, 1.0), (1.0, 2.0 / 21.0)] {
        assert!((near(feature) - expected).abs() < 1e-5, "{}", near(feature));
    }
}

#[test]
fn a_policy_file_answers_on_plain_features_what_the_network_does_on_prepared_ones() {
    for (seed, head, filters) in [(1, Head::Tanh, 0), (2, Head::Linear, 0), (3, Head::Tanh, 8)] {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let before = match filters {
            0 => Vec::new(),
            filters => convolutions(FEATURES, filters),
        };
        let sizes = [FEATURES, 64, 32, 2];
        let network = Network::convolved(before, &sizes, head, &mut random);
        let mut mlp = export::mlp(&network).expect("a net of that size");
        for scene_seed in 0..50 {
            let plain = features(&scene(scene_seed));
            let mut prepared = plain;
            prepare(&mut prepared);
            assert_ne!(prepared, plain);
            let mut tape = Tape::default();
            let expected = network.forward(&prepared, 1, &mut tape);
            let given = mlp.infer(&plain);
            for (given, expected) in given.iter().zip(expected) {
                assert!(
                    (given - expected).abs() < 1e-5,
                    "net {seed}, scene {scene_seed}: {given} and {expected}"
                );
            }
        }
    }
}

#[test]
fn convolutions_see_each_sector_with_two_to_each_side() {
    for (inputs, of_sector) in [(FEATURES, 4), (INPUTS_WITH_MOTION, 6)] {
        let [(first, 3), (second, 3)] = &convolutions(inputs, 3)[..] else {
            panic!("two convolutions of three filters");
        };
        assert_eq!(
            (first.positions(), first.window, first.kept),
            (60, 5 * of_sector, 19)
        );
        assert_eq!(
            (second.positions(), second.window, second.kept),
            (30, 15, 19)
        );
        // The middle sectors of windows, in the order of the circle: ahead, beams 238, 239, 0
        // and 1, and one to the left, each with its velocity.
        for (sector, beams) in [(0, [257, 258, 19, 20]), (7, [45, 46, 47, 48])] {
            let mut expected = beams.to_vec();
            if inputs == INPUTS_WITH_MOTION {
                expected.extend([259 + 2 * sector, 260 + 2 * sector]);
            }
            let window = &first.indices[sector as usize * first.window..][..first.window];
            assert_eq!(window[2 * of_sector..3 * of_sector], expected);
        }
        let of_first = |sector: u32| 19 + 3 * sector..19 + 3 * sector + 3;
        let seen: Vec<u32> = [58, 59, 0, 1, 2].into_iter().flat_map(of_first).collect();
        assert_eq!(second.indices[..15], seen);
        let mut all: Vec<u32> = first.indices.clone();
        all.sort_unstable();
        all.dedup();
        let expected: Vec<u32> = (19..inputs as u32).collect();
        assert_eq!(all, expected, "every beam is in a window");
    }
}
