//! Scans of known places, aligned: the motion between them, its information, and which part
//! of it they do not show.

use allocation_counter::measure;
use nalgebra::{Matrix3, Vector3};
use robot::estimate::{Aligned, Outline, Unaligned, align};
use robot::{Point, wrap_rad};
use vehicle::{Fan, Pose, Scanner, pose};

use crate::dice::Dice;
use crate::walls::{Wall, along, range_m};

const RANGE_STD_M: f64 = 0.02;
const MAX_M: f64 = 50.0;

fn points(places: &[(f64, f64)]) -> Vec<Point> {
    places.iter().map(|(x, y)| Point::new(*x, *y)).collect()
}

/// A room of 12 by 8 m with a pillar.
fn room() -> Vec<Wall> {
    let outer = [
        (-4.0, -3.0),
        (8.0, -3.0),
        (8.0, 5.0),
        (-4.0, 5.0),
        (-4.0, -3.0),
    ];
    let pillar = [(2.0, 2.0), (3.0, 2.0), (3.0, 3.0), (2.0, 3.0), (2.0, 2.0)];
    [along(&points(&outer)), along(&points(&pillar))].concat()
}

/// A corridor 6 m wide, much longer than the scanner sees, in a direction.
fn corridor(direction_rad: f64) -> Vec<Wall> {
    let turn = pose(0.0, 0.0, direction_rad);
    let wall = |y| [turn * Point::new(-500.0, y), turn * Point::new(500.0, y)];
    vec![wall(3.0), wall(-3.0)]
}

/// The ring of the template: walls of 35 and 45 m about the origin.
fn ring() -> Vec<Wall> {
    let circle = |radius_m: f64| {
        let angle = |k: usize| f64::from(k as u32) / 720.0 * std::f64::consts::TAU;
        let place = |k| Point::new(radius_m * angle(k).cos(), radius_m * angle(k).sin());
        along(&(0..=720).map(place).collect::<Vec<_>>())
    };
    [circle(35.0), circle(45.0)].concat()
}

fn fan() -> Fan {
    Scanner::default().fan()
}

fn seen(fan: &Fan, walls: &[Wall], at: &Pose, noise: Option<&mut Dice>) -> Outline {
    let (mount, heading_rad) = (at * fan.mount_body, at.rotation.angle());
    let mut ranges: Vec<f64> = (0..fan.beams)
        .map(|beam| range_m(walls, mount, heading_rad + fan.angle_rad(beam)))
        .collect();
    if let Some(dice) = noise {
        ranges
            .iter_mut()
            .for_each(|range_m| *range_m += RANGE_STD_M * dice.normal());
    }
    let mut outline = Outline::new();
    outline.fill(fan, ranges, MAX_M, RANGE_STD_M);
    outline
}

/// The error of a pose: x, y, heading.
fn error(found: &Pose, truth: &Pose) -> Vector3<f64> {
    let off = found.translation.vector - truth.translation.vector;
    let turn_rad = found.rotation.angle() - truth.rotation.angle();
    Vector3::new(off.x, off.y, wrap_rad(turn_rad))
}

fn motions() -> Vec<Pose> {
    vec![
        pose(0.0, 0.0, 0.0),
        pose(0.4, 0.0, 0.0),
        pose(0.3, 0.1, 0.05),
        pose(-0.2, -0.3, -0.08),
        pose(0.05, 0.4, 0.1),
    ]
}

#[test]
fn known_motions_in_a_room_are_found() {
    let front = Scanner {
        beams: 1080,
        field_of_view_deg: 270.0,
        x_m: 0.5,
        ..Scanner::default()
    };
    for fan in [fan(), front.fan()] {
        let begin = pose(0.5, 0.3, 0.4);
        let reference = seen(&fan, &room(), &begin, None);
        for motion in motions() {
            let current = seen(&fan, &room(), &(begin * motion), None);
            let found = align(&reference, &current, &Pose::identity()).expect("they fit");
            let off = error(&found.reference_from_body, &motion);
            assert_eq!(found.observed, 3, "{motion}: {found:?}");
            assert!(
                off.x.hypot(off.y) < 0.005 && off.z.abs() < 0.001,
                "{motion}: {off}"
            );
        }
    }
}

#[test]
fn the_information_is_that_of_the_errors() {
    let (begin, motion) = (pose(0.5, 0.3, 0.4), pose(0.3, 0.1, 0.05));
    let (mut nees, mut dice) = (0.0, Dice::new(1));
    let runs = 400;
    for _ in 0..runs {
        let reference = seen(&fan(), &room(), &begin, Some(&mut dice));
        let current = seen(&fan(), &room(), &(begin * motion), Some(&mut dice));
        let found = align(&reference, &current, &motion).expect("they fit");
        let off = error(&found.reference_from_body, &motion);
        assert!(off.x.hypot(off.y) < 0.03 && off.z.abs() < 0.01, "{off}");
        nees += off.dot(&(found.information * off)) / f64::from(runs);
    }
    // 3 when it is right. The partners of the points are chosen by the same noise, which the
    // information leaves out.
    println!("mean NEES of the alignment: {nees:.3}");
    assert!((1.5..4.5).contains(&nees), "{nees}");
}

#[test]
fn a_corridor_does_not_show_the_way_along_it() {
    let mut dice = Dice::new(2);
    for direction_rad in [0.0, 0.7, -2.0] {
        let walls = corridor(direction_rad);
        let begin = pose(0.0, 0.0, direction_rad - 0.3);
        // 0.3 m along, 0.2 m to the left and 0.05 rad, seen from the body.
        let aside = Vector3::new(0.3_f64.cos() * 0.3, 0.3_f64.sin() * 0.3, 0.0);
        let across = Vector3::new(-0.3_f64.sin() * 0.2, 0.3_f64.cos() * 0.2, 0.05);
        let motion = pose(aside.x + across.x, aside.y + across.y, 0.05);
        let reference = seen(&fan(), &walls, &begin, Some(&mut dice));
        let current = seen(&fan(), &walls, &(begin * motion), Some(&mut dice));
        let found = align(&reference, &current, &Pose::identity()).expect("they fit");
        assert_eq!(found.observed, 2, "{found:?}");
        // In the frame of the body the corridor is 0.3 rad to the left.
        let way = Vector3::new(0.3_f64.cos(), 0.3_f64.sin(), 0.0);
        assert!(found.weakest.dot(&way).abs() > 0.999, "{found:?}");
        let informs = |direction: &Vector3<f64>| direction.dot(&(found.information * direction));
        let across_way = Vector3::new(-way.y, way.x, 0.0);
        assert!(informs(&way) < 1e-3 * informs(&across_way), "{found:?}");
        let off = error(&found.reference_from_body, &motion);
        assert!(
            off.dot(&across_way).abs() < 0.02 && off.z.abs() < 0.005,
            "{off}"
        );
        // Along the corridor it is still the guess, which was 0.3 m less.
        assert!((off.dot(&way) + 0.3).abs() < 0.03, "{off}");
    }
}

#[test]
fn a_ring_does_not_show_a_turn_about_its_centre() {
    let mut dice = Dice::new(3);
    let begin = pose(40.0, 0.0, std::f64::consts::FRAC_PI_2);
    let reference = seen(&fan(), &ring(), &begin, Some(&mut dice));
    let turned = pose(0.0, 0.0, 0.02) * begin;
    let motion = begin.inverse() * turned;
    let current = seen(&fan(), &ring(), &turned, Some(&mut dice));
    let found = align(&reference, &current, &Pose::identity()).expect("they fit");
    assert_eq!(found.observed, 2, "{found:?}");
    let Aligned { weakest, .. } = found;
    // A metre forwards turns by 1 / 40 rad.
    let turn_per_m = weakest.z / weakest.x;
    assert!((turn_per_m - 1.0 / 40.0).abs() < 0.01, "{found:?}");
    assert!(weakest.y.abs() < 0.1 * weakest.x.abs(), "{found:?}");
    assert!(motion.translation.x > 0.7);
}

#[test]
fn places_on_a_map_are_found_in_the_frame_of_the_map() {
    let (guess, truth) = (pose(0.3, 0.2, 2.0), pose(0.5, 0.05, 2.06));
    let mut reference = seen(&fan(), &room(), &guess, None);
    reference.clone_from(&reference.clone());
    let current = seen(&fan(), &room(), &truth, None);
    let found = align(&reference, &current, &Pose::identity()).expect("they fit");
    let (place, information) = found.seen_from(&guess);
    let off = error(&place, &truth);
    assert!(off.x.hypot(off.y) < 0.005 && off.z.abs() < 0.001, "{off}");
    assert_eq!(information, information.transpose());
    // Turned by the heading of the guess, and no more.
    let turn = guess.rotation.to_rotation_matrix();
    let back = turn.matrix().transpose() * information.fixed_view::<2, 2>(0, 0) * turn.matrix();
    let own = found.information.fixed_view::<2, 2>(0, 0);
    assert!((back - own).amax() < 1e-6 * own.amax());
}

#[test]
fn a_common_error_is_added_to_the_directions_that_are_shown() {
    let (begin, motion) = (pose(0.0, 0.0, -0.3), pose(0.1, 0.1, 0.02));
    for walls in [room(), corridor(0.0)] {
        let reference = seen(&fan(), &walls, &begin, None);
        let current = seen(&fan(), &walls, &(begin * motion), None);
        let found = align(&reference, &current, &Pose::identity()).expect("they fit");
        let blurred = found.blurred(0.02);
        let same = found.blurred(0.0).information - found.information;
        assert!(same.amax() < 1e-9 * found.information.amax());
        // At the lever all directions are metres.
        let at_lever = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 1.0 / found.lever_m));
        let variances = |information: &Matrix3<f64>| {
            let eigenvalues = (at_lever * information * at_lever).symmetric_eigenvalues();
            let mut variances: Vec<f64> = eigenvalues.iter().map(|it| 1.0 / it).collect();
            variances.sort_by(f64::total_cmp);
            variances[..found.observed].to_vec()
        };
        let (before, after) = (
            variances(&found.information),
            variances(&blurred.information),
        );
        if found.observed == 3 {
            for (before, after) in before.iter().zip(&after) {
                assert!((after - before - 4e-4).abs() < 1e-9, "{before} {after}");
            }
        }
        let scale = (1.0 / 4e-4) * (1.0 + found.lever_m * found.lever_m);
        assert!(blurred.information.amax() < scale);
    }
}

#[test]
fn a_car_in_the_scan_that_moves_pulls_little() {
    let car = |x: f64| {
        along(&points(&[
            (x, -2.0),
            (x + 2.0, -2.0),
            (x + 2.0, -1.0),
            (x, -1.0),
        ]))
    };
    let (begin, motion) = (pose(-1.0, 1.0, 0.0), pose(0.3, 0.0, 0.03));
    let reference = seen(&fan(), &[room(), car(3.0)].concat(), &begin, None);
    let moved = [room(), car(3.6)].concat();
    let current = seen(&fan(), &moved, &(begin * motion), None);
    let found = align(&reference, &current, &Pose::identity()).expect("they fit");
    let off = error(&found.reference_from_body, &motion);
    assert!(off.x.hypot(off.y) < 0.03 && off.z.abs() < 0.01, "{off}");
}

#[test]
fn scans_that_show_too_little_are_an_error() {
    let (fan, room) = (fan(), room());
    let here = seen(&fan, &room, &Pose::identity(), None);
    let mut empty = Outline::new();
    let fill = |outline: &mut Outline, ranges: Vec<f64>| outline.fill(&fan, ranges, MAX_M, 0.02);
    assert_eq!(fill(&mut empty, vec![]), 0);
    let none = Err(Unaligned::Pairs { pairs: 0 });
    assert_eq!(align(&here, &empty, &Pose::identity()), none);
    assert_eq!(align(&empty, &here, &Pose::identity()), none);
    let nothing = [f64::NAN, f64::INFINITY, -1.0, 0.0, MAX_M];
    assert_eq!(fill(&mut empty, nothing.repeat(48)), 0);
    assert_eq!(align(&empty, &here, &Pose::identity()), none);
    // More ranges than the fan has beams are not looked at.
    let mut full = Outline::new();
    assert!(fill(&mut full, vec![5.0; 5000]) <= 240);
}

#[test]
fn no_alignment_allocates() {
    let (fan, begin, motion) = (fan(), pose(0.5, 0.3, 0.4), pose(0.3, 0.1, 0.05));
    let control = measure(|| drop(std::hint::black_box(vec![1u8; 100])));
    assert_eq!(control.count_total, 1, "the counter counts");
    let reference = seen(&fan, &room(), &begin, None);
    let mut current = seen(&fan, &room(), &(begin * motion), None);
    let ranges: Vec<f64> = vec![3.0; fan.beams];
    let mut information = Matrix3::zeros();
    let taken = measure(|| {
        let found = align(&reference, &current, &Pose::identity());
        information = found.expect("they fit").information;
        current.fill(&fan, ranges.iter().copied(), MAX_M, RANGE_STD_M);
    });
    assert_eq!((taken.count_total, taken.count_current), (0, 0));
    assert!(information.amax() > 0.0);
}
