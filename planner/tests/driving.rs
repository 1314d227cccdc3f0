//! The loop closed: the plans, tracked as the paper tracks them, drive a car.

use planner::PlannerConfig;

use crate::course::driver::{drive, random_course};
use crate::course::{Course, ROAD_WIDTH_M, Road};

/// The body is inside the road while the centre is this far from its edge, m.
const BODY_M: f64 = 0.926;

#[test]
fn an_empty_course_is_driven_to_its_end() {
    for seed in 0..10 {
        let config = PlannerConfig {
            seed,
            ..PlannerConfig::default()
        };
        let drive = drive(
            &random_course(seed, false),
            config,
            3.5 * (seed % 3) as f64 - 3.5,
        );
        assert!(drive.arrived, "seed {seed}: {drive:?}");
        assert!(drive.edge_m > BODY_M, "seed {seed}: {drive:?}");
        assert_eq!(drive.blocked, 0, "seed {seed}: {drive:?}");
    }
}

#[test]
fn tight_bends_to_both_sides_are_driven_inside_the_road() {
    for radius_m in [10.0f64, -10.0, 15.0, -15.0, 30.0, -30.0] {
        let course = Course::new(&[
            Road {
                length_m: 40.0,
                curvature_per_m: 0.0,
            },
            Road {
                length_m: 1.5 * radius_m.abs(),
                curvature_per_m: 1.0 / radius_m,
            },
            Road {
                length_m: 40.0,
                curvature_per_m: 0.0,
            },
        ]);
        let drive = drive(&course, PlannerConfig::default(), 0.0);
        assert!(
            drive.arrived && drive.edge_m > BODY_M,
            "radius {radius_m}: {drive:?}"
        );
        assert!(drive.edge_m < ROAD_WIDTH_M / 2.0);
    }
}

/// With the paper's 0.5 m the body, 0.93 m to either side, touches what the path
/// passes; half the width and a little more is needed to touch nothing.
#[test]
fn with_room_for_the_body_obstacles_are_passed_untouched() {
    let mut near = 0;
    for seed in 0..12 {
        let config = PlannerConfig {
            seed,
            inflation_m: 1.2,
            ..PlannerConfig::default()
        };
        let drive = drive(&random_course(seed, true), config, 0.0);
        assert!(
            drive.arrived && drive.clearance_m > 0.0,
            "seed {seed}: {drive:?}"
        );
        near += usize::from(drive.clearance_m < 1.5);
    }
    assert!(near > 4, "only {near} courses had an obstacle in the way");
}
