//! Where the beams of a scanner look.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use proptest::prelude::*;
use vehicle::{Fan, Point, Scanner};

/// No gap between two beams is as wide, m.
const ANY_M: f64 = f64::INFINITY;

/// Whether a place is in the field of view.
fn covers(fan: &Fan, place_body: Point) -> bool {
    fan.sight().covers(place_body, ANY_M)
}

fn scanner(beams: u32, field_of_view_deg: f64) -> Scanner {
    Scanner {
        beams,
        field_of_view_deg,
        ..Scanner::default()
    }
}

#[test]
fn a_circle_begins_at_the_heading_and_ends_one_gap_before_it() {
    let fan = scanner(4, 360.0).fan();
    assert!(fan.is_circle());
    let angles = [0, 1, 2, 3].map(|beam| fan.angle_rad(beam));
    assert_eq!(angles, [0.0, FRAC_PI_2, PI, 1.5 * PI]);
    let default = Scanner::default().fan();
    for beam in 0..240 {
        let plain_rad = TAU * beam as f64 / 240.0;
        assert_eq!(default.angle_rad(beam).to_bits(), plain_rad.to_bits());
    }
}

#[test]
fn a_partial_fan_ends_at_both_limits() {
    let fan = scanner(1080, 270.0).fan();
    let limit_rad = 135f64.to_radians();
    assert_eq!(fan.angle_rad(0), -limit_rad);
    assert_eq!(fan.angle_rad(1079), limit_rad);
    assert_eq!(scanner(1, 90.0).fan().angle_rad(0), 0.0);
    let turned = Scanner {
        heading_deg: 90.0,
        x_m: 2.0,
        ..scanner(3, 180.0)
    };
    let point = turned.fan().point_body(1, 4.0);
    assert!((point - Point::new(2.0, 4.0)).norm() < 1e-12, "{point}");
}

#[test]
fn what_no_beam_looks_at_is_not_covered() {
    let front = Scanner {
        x_m: 2.0,
        ..scanner(181, 180.0)
    };
    let fan = front.fan();
    for (x_m, y_m, covered) in [
        (10.0, 0.0, true),
        (2.1, 5.0, true),
        (1.5, 5.0, false),
        (-3.0, 0.0, false),
        (0.0, 0.0, false),
    ] {
        assert_eq!(covers(&fan, Point::new(x_m, y_m)), covered, "{x_m}, {y_m}");
    }
    assert!(covers(&Scanner::default().fan(), Point::new(-3.0, 0.0)));
}

#[test]
fn a_fan_without_beams_covers_nothing() {
    for field_of_view_deg in [90.0, 270.0, 360.0] {
        let fan = scanner(0, field_of_view_deg).fan();
        assert!(!fan.sight().covers_all(1.0, ANY_M));
        for (x_m, y_m) in [(10.0, 0.0), (0.0, 5.0), (-3.0, 0.0), (0.0, 0.0)] {
            let point = Point::new(x_m, y_m);
            assert!(!covers(&fan, point), "{field_of_view_deg}: {point}");
        }
    }
    let covers_all =
        |beams: u32, deg: f64| scanner(beams, deg).fan().sight().covers_all(1.0, ANY_M);
    // Beyond the outer beams half of their spacing is seen, too.
    assert!(covers_all(1, 360.0) && covers_all(240, 359.0) && !covers_all(240, 357.0));
}

#[test]
fn impossible_scanners_are_refused_by_name() {
    let change = |change: fn(&mut Scanner)| {
        let mut scanner = Scanner::default();
        change(&mut scanner);
        scanner.validated().expect_err("refused").to_string()
    };
    for (text, name) in [
        (change(|s| s.beams = 0), "beams = 0"),
        (change(|s| s.beams = 2049), "beams = 2049"),
        (
            change(|s| s.field_of_view_deg = f64::NAN),
            "field_of_view_deg",
        ),
        (change(|s| s.field_of_view_deg = 361.0), "field_of_view_deg"),
        (change(|s| s.range_m = f64::INFINITY), "range_m"),
        (change(|s| s.x_m = f64::NAN), "x_m"),
        (change(|s| s.drop_probability = 1.0), "drop_probability"),
        (change(|s| s.drop_probability = -0.1), "drop_probability"),
    ] {
        assert!(text.starts_with(name), "{text}");
    }
}

proptest! {
    #[test]
    fn a_direction_is_that_of_its_angle(beams in 1..2048u32, deg in 1.0..360.0f64, at in 0.0..1.0f64, turned in -180.0..180.0f64) {
        let fan = Scanner { heading_deg: turned, ..scanner(beams, deg) }.fan();
        let circle = scanner(beams, 360.0).fan();
        let beam = (at * f64::from(beams)) as usize;
        for fan in [fan, circle] {
            let direction = fan.direction_body(beam);
            let (sin, cos) = fan.angle_rad(beam).sin_cos();
            prop_assert!((direction.x - cos).abs() < 1e-12 && (direction.y - sin).abs() < 1e-12);
            prop_assert!(covers(&fan, fan.point_body(beam, 3.0)));
        }
    }

    #[test]
    fn left_and_right_are_mirrored_to_the_last_bit(beams in 2..2048u32, deg in 1.0..360.0f64, at in 0.0..1.0f64) {
        let beam = (at * f64::from(beams)) as usize;
        let mirrored = |fan: Fan, other: usize| {
            let (a, b) = (fan.direction_body(beam), fan.direction_body(other));
            (a.x, a.y) == (b.x, -b.y)
        };
        prop_assert!(mirrored(scanner(beams, deg).fan(), beams as usize - 1 - beam));
        let circle = scanner(beams, 360.0).fan();
        prop_assert!(mirrored(circle, (beams as usize - beam) % beams as usize));
    }

    #[test]
    fn the_beam_at_its_angle_is_the_beam(beams in 2..2048u32, deg in 1.0..359.0f64, at in 0.0..1.0f64) {
        let beam = (at * f64::from(beams)) as usize;
        for fan in [scanner(beams, deg).fan(), scanner(beams, 360.0).fan()] {
            prop_assert!((fan.beam_at(fan.angle_rad(beam)) - beam as f64).abs() < 1e-6);
        }
    }
}

#[test]
fn a_few_wide_gaps_are_not_sight() {
    let single = Scanner {
        beams: 1,
        field_of_view_deg: 90.0,
        ..Scanner::default()
    };
    let fan = single.fan();
    assert!(covers(&fan, Point::new(1.0, 0.99)));
    let beyond_deg = |deg: f64| Point::new(deg.to_radians().cos(), deg.to_radians().sin());
    assert!(covers(&fan, beyond_deg(49.0)) && !covers(&fan, beyond_deg(51.0)));
}

#[test]
fn between_two_beams_a_place_is_seen_as_far_as_no_car_fits() {
    for (beams, field_of_view_deg) in [(12, 360.0), (10, 270.0)] {
        // Beams each 30 degrees, one of them straight ahead or 15 degrees beside it.
        let sight = scanner(beams, field_of_view_deg).fan().sight();
        let at = |far_m: f64, deg: f64| {
            Point::new(
                far_m * deg.to_radians().cos(),
                far_m * deg.to_radians().sin(),
            )
        };
        let middle_deg = if beams == 12 { 15.0 } else { 30.0 };
        // 15 degrees beside a beam, 2 m are reached 7.73 m away.
        assert!(sight.covers(at(7.7, middle_deg), 2.0), "{beams} beams");
        assert!(!sight.covers(at(7.8, middle_deg), 2.0), "{beams} beams");
        assert!(sight.covers(at(40.0, middle_deg - 15.0), 2.0));
        assert!(!sight.covers(at(40.0, middle_deg - 11.0), 2.0));
        assert!(sight.has_no_gap(7.7, 2.0) && !sight.has_no_gap(7.8, 2.0));
    }
    // One beam sees what is ahead and beside it, and nothing behind.
    let sight = scanner(1, 360.0).fan().sight();
    assert!(sight.covers(Point::new(30.0, 1.9), 2.0) && !sight.covers(Point::new(30.0, 2.1), 2.0));
    assert!(!sight.covers(Point::new(-3.0, 0.0), 2.0));
}

proptest! {
    /// Against the definition: the field of view by angles, and each beam.
    #[test]
    fn a_place_is_seen_beside_a_beam_and_within_the_field_of_view(
        beams in 2..400u32, deg in 5.0..365.0f64, heading_deg in -180.0..180.0f64,
        x_m in -30.0..30.0f64, y_m in -30.0..30.0f64, beside_m in 0.1..3.0f64,
    ) {
        let fan = Scanner { heading_deg, x_m: 1.0, ..scanner(beams, deg.min(360.0)) }.fan();
        let place = Point::new(x_m, y_m);
        let from_mount = place - fan.mount_body;
        let off_rad = vehicle::wrap_rad(from_mount.y.atan2(from_mount.x) - fan.heading_rad).abs();
        let beside = |beam: usize| {
            let along = fan.direction_body(beam);
            let is_ahead = along.dot(&from_mount) > 0.0;
            if is_ahead { along.perp(&from_mount).abs() } else { f64::INFINITY }
        };
        let nearest_m = (0..fan.beams).map(beside).fold(f64::INFINITY, f64::min);
        let half_rad = if fan.is_circle() { PI } else { fan.seen_half_rad().min(PI) };
        let near_m = (nearest_m - beside_m).abs().min((off_rad - half_rad).abs());
        // Within the distance that is asked for, what is behind a lone beam counts, too.
        if near_m > 1e-9 && from_mount.norm() > beside_m {
            let expected = off_rad <= half_rad && nearest_m <= beside_m;
            prop_assert_eq!(fan.sight().covers(place, beside_m), expected, "{:?}", place);
        }
    }
}
