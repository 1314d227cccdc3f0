//! Compares a lane's coordinates and surface with their definitions.

use std::f64::consts::{PI, TAU};

use parry2d_f64::math::Vector as ParryVector;
use parry2d_f64::transformation::convex_hull;
use proptest::prelude::*;
use sim::lane::{ArcShape, Lane, Turn, wrap_rad};
use vehicle::{Point, Vector};

prop_compose! {
    fn arc()(
        (x, y) in (-500.0..500.0, -500.0..500.0),
        radius_m in 5.0..120.0,
        start_phase_rad in -PI..PI,
        angle_rad in 0.1..2.5,
        left in any::<bool>(),
        width_m in 2.5..5.0,
    ) -> Lane {
        let turn = if left { Turn::Left } else { Turn::Right };
        let center_world = Point::new(x, y);
        Lane::arc(ArcShape { center_world, radius_m, start_phase_rad, angle_rad, turn }, width_m)
    }
}

prop_compose! {
    fn straight()(
        (x, y) in (-500.0..500.0, -500.0..500.0),
        heading_rad in -PI..PI,
        length_m in 2.0..120.0,
        width_m in 2.5..5.0,
    ) -> Lane {
        let start_world = Point::new(x, y);
        let along: Vector = length_m * Vector::new(f64::cos(heading_rad), f64::sin(heading_rad));
        Lane::straight(start_world, start_world + along, width_m)
    }
}

fn lane() -> impl Strategy<Value = Lane> {
    prop_oneof![arc(), straight()]
}

/// The surface as the simulator makes it: the convex hull of samples every
/// metre on both edges, for arcs with a metre of straight road at both ends.
fn sampled_hull(lane: &Lane) -> Vec<ParryVector> {
    let half_m = lane.width_m / 2.0;
    let mut points = Vec::new();
    let last = lane.length_m.ceil() as u32;
    let is_arc = lane.bend_radius().is_some();
    for k in 0..=last {
        // The samples between the ends of a straight edge are not corners, although
        // rounding makes some of them look like corners.
        if !is_arc && k != 0 && k != last {
            continue;
        }
        for lateral_m in [half_m, -half_m] {
            points.push(lane.position(f64::from(k), lateral_m));
        }
    }
    if is_arc {
        let last = points.len();
        let (entry, exit) = (lane.forward_at(0.0), lane.forward_at(lane.length_m));
        points.extend([points[0] - entry, points[1] - entry]);
        points.extend([points[last - 1] + exit, points[last - 2] + exit]);
    }
    let points: Vec<ParryVector> = points.iter().map(|p| ParryVector::new(p.x, p.y)).collect();
    convex_hull(&points)
}

/// How far a point is inside a convex, counter-clockwise polygon, m.
fn depth_m(polygon: &[ParryVector], point: Point) -> f64 {
    let point = ParryVector::new(point.x, point.y);
    let edges = (0..polygon.len()).map(|i| (polygon[i], polygon[(i + 1) % polygon.len()]));
    edges
        .map(|(a, b)| (b - a).normalize().perp_dot(point - a))
        .fold(f64::INFINITY, f64::min)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(1000) })]

    #[test]
    fn coordinates_lead_back(lane in lane(), along in 0.0..1.0, lateral_m in -2.0..2.0) {
        let longitudinal_m = along * lane.length_m;
        let point_world = lane.position(longitudinal_m, lateral_m);
        let (back_m, back_lateral_m) = lane.local_coordinates(point_world);
        prop_assert!((back_m - longitudinal_m).abs() < 1e-6, "{back_m} for {longitudinal_m}");
        prop_assert!((back_lateral_m - lateral_m).abs() < 1e-6);
    }

    #[test]
    fn lateral_is_to_the_right_and_headings_point_along(lane in lane(), along in 0.0..1.0) {
        let longitudinal_m = along * lane.length_m;
        let here = lane.position(longitudinal_m, 0.0);
        let forward = lane.forward_at(longitudinal_m);
        let right = Vector::new(forward.y, -forward.x);
        prop_assert!((lane.position(longitudinal_m, 1.0) - here - right).norm() < 1e-6);
        let heading_rad = lane.heading_at(longitudinal_m);
        prop_assert!((wrap_rad(heading_rad - forward.y.atan2(forward.x))).abs() < 1e-9);
        let ahead = (lane.position(longitudinal_m + 1e-4, 0.0) - here) / 1e-4;
        prop_assert!((ahead - forward).norm() < 1e-3);
    }

    #[test]
    fn the_surface_is_the_hull_of_the_samples(
        lane in lane(),
        (across, along) in (-3.0..3.0, -0.2..1.2),
    ) {
        let hull = sampled_hull(&lane);
        let point_world = lane.position(along * lane.length_m, across * lane.width_m);
        let depth_m = depth_m(&hull, point_world);
        prop_assume!(depth_m.abs() > 1e-6);
        prop_assert_eq!(lane.surface_contains(point_world, 0.0), depth_m > 0.0, "depth {} m", depth_m);
        if depth_m > 0.0 {
            prop_assert!(lane.surface_bounds().contains(point_world, 0.0));
        }
        if depth_m > -0.5 && depth_m < 0.0 {
            prop_assert!(lane.surface_contains(point_world, 0.5));
        }
    }

    #[test]
    fn the_surface_has_the_hulls_corners(lane in lane()) {
        let hull = sampled_hull(&lane);
        for corner in lane.surface() {
            prop_assert!(depth_m(&hull, corner).abs() < 1e-6, "{corner} is no corner");
        }
        let surface: Vec<ParryVector> =
            lane.surface().iter().map(|p| ParryVector::new(p.x, p.y)).collect();
        for corner in hull {
            let inside_m = depth_m(&surface, Point::new(corner.x, corner.y));
            prop_assert!(inside_m.abs() < 1e-6, "{corner} is {inside_m} m inside");
        }
    }

    #[test]
    fn wrapping_keeps_the_direction(angle_rad in -100.0..100.0) {
        let wrapped_rad = wrap_rad(angle_rad);
        prop_assert!(wrapped_rad > -PI && wrapped_rad <= PI);
        let turns = (angle_rad - wrapped_rad) / TAU;
        prop_assert!((turns - turns.round()).abs() < 1e-9);
    }
}
