//! Compares beams with an oracle that knows only line segments and points on a circle.

use proptest::prelude::*;
use sim::contact::{Placed, Shape, overlap};
use sim::lidar::{Lidar, Origin};
use vehicle::{Footprint, Point, Scanner, Vector};

const RANGE_M: f64 = 50.0;

fn placed() -> impl Strategy<Value = Placed> {
    let shape = prop_oneof![
        (0.3..6.0, 0.3..3.0)
            .prop_map(|(length_m, width_m)| Shape::Box(Footprint { length_m, width_m })),
        (0.1..1.0).prop_map(|radius_m| Shape::Disc { radius_m }),
    ];
    (shape, -60.0..60.0, -60.0..60.0, -3.2..3.2_f64).prop_map(|(shape, x, y, turn)| Placed {
        shape,
        center_world: Point::new(x, y),
        forward_world: Vector::new(turn.cos(), turn.sin()),
    })
}

/// The outline of a body as a fine polygon.
fn outline(body: &Placed) -> Vec<Point> {
    match body.shape {
        Shape::Box(_) => body.corners_world().to_vec(),
        Shape::Disc { radius_m } => (0..720)
            .map(|k| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 720.0).sin_cos();
                body.center_world + radius_m * Vector::new(cos, sin)
            })
            .collect(),
    }
}

/// Distance along a ray to a segment.
fn meets(from: Point, along: Vector, a: Point, b: Point) -> Option<f64> {
    let side = b - a;
    let cross = along.perp(&side);
    let distance_m = (a - from).perp(&side) / cross;
    let share = (a - from).perp(&along) / cross;
    (distance_m >= 0.0 && (0.0..=1.0).contains(&share)).then_some(distance_m)
}

#[test]
fn bodies_with_the_same_centre_overlap() {
    for shape in [
        Shape::Disc { radius_m: 0.5 },
        Shape::Box(Footprint {
            length_m: 4.0,
            width_m: 2.0,
        }),
    ] {
        let body = Placed {
            shape,
            center_world: Point::new(3.0, 4.0),
            forward_world: Vector::x(),
        };
        let found = overlap(&body, &body).expect("they overlap");
        assert!(
            found.depth_m > 0.0 && found.normal_world.norm() > 0.99,
            "{found:?}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn beams_end_where_they_meet_an_outline(
        bodies in prop::collection::vec(placed(), 0..6),
        turn_rad in -3.2..3.2_f64,
        fan in (1u32..1200, prop_oneof![Just(360.0), 20.0..360.0_f64], prop_oneof![Just(0.0), -180.0..180.0_f64]),
    ) {
        let (beams, field_of_view_deg, heading_deg) = fan;
        let scanner = Scanner { beams, field_of_view_deg, heading_deg, range_m: RANGE_M, ..Scanner::default() };
        let position_world = Point::new(0.3, -0.2);
        let origin = Origin {
            position_world,
            forward_world: Vector::new(turn_rad.cos(), turn_rad.sin()),
        };
        let bodies: Vec<Placed> = bodies
            .into_iter()
            .filter(|body| (body.center_world - position_world).norm() > body.shape.radius_m())
            .collect();
        let mut ranges_m = vec![0.0_f32; beams as usize];
        Lidar::new(&scanner).scan(&origin, bodies.iter().copied(), &mut ranges_m);
        let outlines: Vec<Vec<Point>> = bodies.iter().map(outline).collect();
        for (k, &range_m) in ranges_m.iter().enumerate() {
            let angle_rad = turn_rad + scanner.fan().angle_rad(k);
            let along = Vector::new(angle_rad.cos(), angle_rad.sin());
            // A beam that only grazes a body may hit it or not: the oracle's answers
            // for beams slightly to either side bound the correct one.
            let near_far = [-1e-4, 0.0, 1e-4].map(|hair_rad: f64| {
                let along = nalgebra::Rotation2::new(hair_rad) * along;
                outlines
                    .iter()
                    .flat_map(|points| {
                        let next = points.iter().cycle().skip(1);
                        points.iter().zip(next).filter_map(|(&a, &b)| meets(position_world, along, a, b))
                    })
                    .fold(RANGE_M, f64::min)
            });
            let least = near_far.iter().copied().fold(f64::INFINITY, f64::min) - 0.05;
            let most = near_far.iter().copied().fold(0.0, f64::max) + 0.05;
            prop_assert!(
                (least..=most).contains(&f64::from(range_m)),
                "beam {k}: {range_m} not in {least}..={most}"
            );
        }
    }

    #[test]
    fn overlaps_are_found_from_both_sides_and_part_along_their_normal(
        first in placed(),
        offset in (-4.0..4.0, -4.0..4.0),
        second in placed(),
    ) {
        let mut second = second;
        second.center_world = first.center_world + Vector::new(offset.0, offset.1);
        let there = overlap(&first, &second);
        let back = overlap(&second, &first);
        prop_assert_eq!(there.is_some(), back.is_some());
        if let Some(found) = there {
            let mut moved = first;
            moved.center_world += found.normal_world * (found.depth_m + 1e-6);
            prop_assert!(overlap(&moved, &second).is_none(), "{found:?} does not part them");
        } else {
            let inside = outline(&first).into_iter().any(|point| {
                let dot = Placed {
                    shape: Shape::Disc { radius_m: 1e-9 },
                    center_world: point,
                    forward_world: Vector::x(),
                };
                overlap(&dot, &second).is_some()
            });
            prop_assert!(!inside, "a corner of the first is inside the second");
        }
    }
}
