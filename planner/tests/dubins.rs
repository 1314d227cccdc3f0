//! Dubins curves against a search that knows no formula.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use planner::{Dubins, Turn};
use proptest::prelude::*;
use vehicle::{Pose, Vector, pose, wrap_rad};

/// The words as signs of their turns.
const WORDS: [[f64; 3]; 6] = [
    [1.0, 0.0, 1.0],
    [-1.0, 0.0, -1.0],
    [1.0, 0.0, -1.0],
    [-1.0, 0.0, 1.0],
    [1.0, -1.0, 1.0],
    [-1.0, 1.0, -1.0],
];

/// An arc of radius 1 by an angle, to the left or right.
fn arc(at: Pose, sign: f64, angle_rad: f64) -> Pose {
    let centre = at * vehicle::Point::new(0.0, sign);
    let arm = at * vehicle::Point::origin() - centre;
    let turned = Pose::rotation(sign * angle_rad) * arm;
    let end = centre + turned;
    pose(end.x, end.y, at.rotation.angle() + sign * angle_rad)
}

fn centre(at: Pose, sign: f64) -> Vector {
    (at * vehicle::Point::new(0.0, sign)).coords
}

/// How far a first arc of an angle is from being that of the word, signed; and
/// the lengths of the other two pieces. Radius 1.
fn miss(to: Pose, word: [f64; 3], first_rad: f64) -> (f64, f64, f64) {
    let at = arc(Pose::identity(), word[0], first_rad);
    let heading_rad = |pose: Pose| pose.rotation.angle();
    if word[1] == 0.0 {
        // The line has to touch the last circle, which lies on one side of it.
        let way = centre(to, word[2]) - centre(at, word[2]);
        let (ahead, across) = (
            way.dot(&(at.rotation * Vector::x())),
            way.dot(&(at.rotation * Vector::y())),
        );
        let last_rad = word[2] * (heading_rad(to) - heading_rad(at));
        return (across, ahead, last_rad.rem_euclid(TAU));
    }
    // The middle circle has to touch the last one.
    let (middle, last) = (centre(at, word[1]), centre(to, word[2]));
    let apart = (last - middle).norm();
    // There, the car looks across the line between both centres.
    let touch_rad = (last - middle).y.atan2((last - middle).x);
    let meeting_rad = touch_rad + word[1] * FRAC_PI_2;
    let middle_rad = word[1] * (meeting_rad - heading_rad(at));
    let last_rad = word[2] * (heading_rad(to) - meeting_rad);
    (
        apart - 2.0,
        middle_rad.rem_euclid(TAU),
        last_rad.rem_euclid(TAU),
    )
}

/// Length of the shortest curve, by trying first arcs of all lengths, and
/// halving wherever the miss changes its sign. Radius 1.
fn brute_force(to: Pose) -> f64 {
    const STEPS: usize = 2000;
    let mut best = f64::INFINITY;
    for word in WORDS {
        let angle_rad = |step: usize| TAU * step as f64 / STEPS as f64;
        for step in 0..STEPS {
            let (mut low, mut high) = (angle_rad(step), angle_rad(step + 1));
            let low_miss = miss(to, word, low).0;
            if low_miss.signum() == miss(to, word, high).0.signum() {
                continue;
            }
            for _ in 0..60 {
                let middle = (low + high) / 2.0;
                match miss(to, word, middle).0.signum() == low_miss.signum() {
                    true => low = middle,
                    false => high = middle,
                }
            }
            for first in [low, high] {
                let (left, second, third) = miss(to, word, first);
                // A full turn less a billionth is none.
                let third = if third > TAU - 1e-7 { 0.0 } else { third };
                if left.abs() < 1e-9 && second >= -1e-9 {
                    best = best.min(first + second + third);
                }
            }
        }
    }
    best
}

fn wild_pose() -> impl Strategy<Value = Pose> {
    (-8.0..8.0, -8.0..8.0, -PI..PI).prop_map(|(x_m, y_m, heading_rad)| pose(x_m, y_m, heading_rad))
}

fn mirrored(at: &Pose) -> Pose {
    let mut mirror = *at;
    mirror.translation.vector.y = -at.translation.vector.y;
    mirror.rotation = at.rotation.inverse();
    mirror
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_word_is_shorter(to in wild_pose(), radius_m in 0.5..7.0f64) {
        let curve = Dubins::shortest(&Pose::identity(), &to, radius_m);
        let unit = pose(to.translation.x / radius_m, to.translation.y / radius_m, to.rotation.angle());
        let length_m = radius_m * brute_force(unit);
        prop_assert!((curve.length_m() - length_m).abs() < 1e-5 * radius_m, "{} {}", curve.length_m(), length_m);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 10_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn it_ends_where_it_should(from in wild_pose(), to in wild_pose(), radius_m in 0.5..7.0f64) {
        let curve = Dubins::shortest(&from, &to, radius_m);
        let end = curve.at(&from, curve.length_m());
        prop_assert!((end.translation.vector - to.translation.vector).norm() < 1e-7);
        prop_assert!(wrap_rad(end.rotation.angle() - to.rotation.angle()).abs() < 1e-7);
        let straight_m = (from.translation.vector - to.translation.vector).norm();
        prop_assert!(curve.length_m() >= straight_m - 1e-9);
        let turn_rad = wrap_rad(from.rotation.angle() - to.rotation.angle()).abs();
        prop_assert!(curve.length_m() >= radius_m * turn_rad - 1e-6);
    }

    #[test]
    fn left_and_right_are_alike_to_the_last_bit(to in wild_pose(), radius_m in 0.5..7.0f64) {
        let here = Pose::identity();
        let curve = Dubins::shortest(&here, &to, radius_m);
        let mirror = Dubins::shortest(&here, &mirrored(&to), radius_m);
        prop_assert_eq!(curve.length_m(), mirror.length_m());
    }

    #[test]
    fn backwards_it_is_as_long(from in wild_pose(), to in wild_pose(), radius_m in 0.5..7.0f64) {
        let turned = |at: &Pose| at * pose(0.0, 0.0, PI);
        let there_m = Dubins::shortest(&from, &to, radius_m).length_m();
        let back_m = Dubins::shortest(&turned(&to), &turned(&from), radius_m).length_m();
        prop_assert!((there_m - back_m).abs() < 1e-6, "{} {}", there_m, back_m);
    }

    /// Walked in steps, it turns no tighter than the radius, and never jumps.
    #[test]
    fn it_can_be_driven(from in wild_pose(), to in wild_pose(), radius_m in 0.5..7.0f64) {
        let curve = Dubins::shortest(&from, &to, radius_m);
        let step_m = curve.length_m() / 500.0;
        let mut before = from;
        for step in 1..=500 {
            let distance_m = f64::from(step) * step_m;
            let at = curve.at(&from, distance_m);
            let turn_rad = wrap_rad(at.rotation.angle() - before.rotation.angle()).abs();
            prop_assert!(turn_rad <= step_m / radius_m + 1e-9, "turns by {}", turn_rad);
            let moved_m = (at.translation.vector - before.translation.vector).norm();
            prop_assert!(moved_m <= step_m + 1e-9);
            // An arc of an eighth of a turn at most is not much longer than its chord.
            prop_assert!(moved_m >= step_m * 0.97 || step_m > 0.7 * radius_m);
            prop_assert!(curve.curvature_per_m(distance_m).abs() <= 1.0 / radius_m);
            before = at;
        }
    }
}

#[test]
fn plain_ways_are_plain() {
    let here = Pose::identity();
    let length_m = |to: Pose| Dubins::shortest(&here, &to, 2.0).length_m();
    assert_eq!(length_m(here), 0.0);
    assert_eq!(length_m(pose(7.0, 0.0, 0.0)), 7.0);
    assert!((length_m(pose(2.0, 2.0, FRAC_PI_2)) - PI).abs() < 1e-9);
    assert!((length_m(pose(0.0, 4.0, PI)) - TAU).abs() < 1e-9);
    // Its own place the other way round: three arcs.
    let curve = Dubins::shortest(&here, &pose(0.0, 0.0, PI), 2.0);
    assert!(
        curve
            .pieces
            .iter()
            .all(|piece| piece.turn != Turn::Straight)
    );
    assert!(
        (curve.length_m() - 2.0 * (TAU + PI / 3.0)).abs() < 1e-6,
        "{}",
        curve.length_m()
    );
    // A little more than a full turn to the left is no way to go straight on.
    assert!(length_m(pose(5.0, 1e-13, -1e-13)) < 5.0 + 1e-6);
}
