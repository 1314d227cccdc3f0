//! Where the local goal is.

use planner::{Corridor, Grid, PlannerConfig, choose_goal};
use proptest::prelude::*;
use shm_config::message::Observation;
use vehicle::{Point, State, pose};

use crate::course::{CAR, Course, ROAD_WIDTH_M, Road};
use crate::reference::{small_config, wild_observation};

fn goal_body(config: &PlannerConfig, observation: &Observation) -> Point {
    let mut grid = Grid::new(config);
    grid.fill(observation);
    choose_goal(&grid, config, observation)
}

/// The car on the course, so far along, left of the middle line, and turned.
fn state(course: &Course, along_m: f64, across_m: f64, turned_rad: f64) -> State {
    let world_from_body = course.pose_at(along_m) * pose(0.0, across_m, turned_rad);
    State {
        position: world_from_body.translation.vector.into(),
        heading_rad: world_from_body.rotation.angle(),
        speed_mps: 5.0,
    }
}

fn straight() -> Course {
    Course::new(&[Road {
        length_m: 100.0,
        curvature_per_m: 0.0,
    }])
}

fn bend(radius_m: f64) -> Course {
    let curvature_per_m = 1.0 / radius_m;
    Course::new(&[
        Road {
            length_m: 40.0,
            curvature_per_m: 0.0,
        },
        Road {
            length_m: 1.5 * radius_m.abs(),
            curvature_per_m,
        },
        Road {
            length_m: 40.0,
            curvature_per_m: 0.0,
        },
    ])
}

/// On the course, and so far left of its middle line.
fn on_course(course: &Course, state: &State, config: &PlannerConfig) -> (f64, f64) {
    let goal_body = goal_body(config, &course.observe(state, 0));
    let place = course.place(state.pose() * goal_body);
    (place.along_m, place.across_m)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_goal_is_in_the_grid_and_in_the_corridor(config in small_config(), seed: u64) {
        let observation = wild_observation(seed);
        let goal_body = goal_body(&config, &observation);
        prop_assert!(goal_body.x >= 3.0 && goal_body.x <= config.x_max_m);
        let lane = Corridor::lane(&observation.road, config.lane_margin_m, config.y_max_m);
        prop_assert!(lane.right_m <= lane.left_m);
        prop_assert!((lane.right_m..=lane.left_m).contains(&goal_body.y));
    }

    /// On an empty road, wherever the car is and however it is turned.
    #[test]
    fn on_a_straight_road_it_is_15_m_ahead_in_the_middle(
        across_m in -3.0..3.0, turned_rad in -0.1..0.1f64,
    ) {
        let course = straight();
        let state = state(&course, 20.0, across_m, turned_rad);
        let (along_m, goal_across_m) = on_course(&course, &state, &PlannerConfig::default());
        prop_assert!((along_m - 35.0).abs() < 0.1, "{}", along_m);
        prop_assert!(goal_across_m.abs() < 0.1, "{}", goal_across_m);
    }

    /// In a bend the goal is on the arc, nearer the tighter the bend is.
    #[test]
    fn in_a_bend_it_is_on_the_middle_line(
        radius_m in 15.0..80.0f64, right: bool, across_m in -2.0..2.0, along in 0.0..0.5,
    ) {
        let radius_m = if right { -radius_m } else { radius_m };
        let course = bend(radius_m);
        let along_m = 40.0 + along * 1.5 * radius_m.abs();
        let state = state(&course, along_m, across_m, 0.0);
        let config = PlannerConfig::default();
        let (goal_along_m, goal_across_m) = on_course(&course, &state, &config);
        let ahead_m = goal_along_m - along_m;
        // length * turn / 8 = sag
        let most_m = (8.0 * config.goal_sag_m * radius_m.abs()).sqrt().min(15.0);
        prop_assert!(ahead_m <= most_m + 0.1 && ahead_m > most_m - 0.7, "{} of {}", ahead_m, most_m);
        prop_assert!(goal_across_m.abs() < 0.05, "{}", goal_across_m);
    }
}

#[test]
fn passing_a_checkpoint_does_not_make_it_jump() {
    for radius_m in [20.0, -20.0, 45.0, -45.0] {
        let course = bend(radius_m);
        let goal_along_m = |along_m: f64| {
            on_course(
                &course,
                &state(&course, along_m, 0.5, 0.02),
                &PlannerConfig::default(),
            )
            .0
        };
        let mut before_m = goal_along_m(1.0);
        for step in 1..=(course.length_m() - 20.0) as usize * 4 {
            let along_m = 1.0 + step as f64 * 0.25;
            let now_m = goal_along_m(along_m);
            // It leaps ahead when a bend straightens, never back by more than
            // the steps of half a metre in which it is looked for.
            let moved_m = now_m - before_m;
            assert!(
                (-0.8..4.0).contains(&moved_m),
                "radius {radius_m}, {along_m}: {moved_m}"
            );
            before_m = now_m;
        }
    }
}

#[test]
fn a_checkpoint_that_has_been_passed_is_left_out() {
    let mut observation = straight().observe(&state(&straight(), 20.0, 1.0, 0.0), 0);
    let expected = goal_body(&PlannerConfig::default(), &observation);
    assert!(
        (expected - Point::new(15.0, -1.0)).norm() < 0.05,
        "{expected}"
    );
    // The first one just behind, and off the road: it must not matter.
    observation.checkpoints[0].x_body_m = -3.0;
    observation.checkpoints[0].y_body_m = 9.0;
    assert_eq!(goal_body(&PlannerConfig::default(), &observation), expected);
    // Both behind: straight along the road, as near as goals are.
    observation.checkpoints[1].x_body_m = -1.0;
    let near = goal_body(&PlannerConfig::default(), &observation);
    assert!((near - Point::new(3.0, -1.0)).norm() < 0.05, "{near}");
}

#[test]
fn a_checkpoint_near_by_is_led_through_to_the_next() {
    let course = bend(60.0);
    let state = state(&course, 38.0, 0.0, 0.0);
    let (along_m, across_m) = on_course(&course, &state, &PlannerConfig::default());
    assert!(
        along_m > 46.0 && across_m.abs() < 0.1,
        "{along_m} {across_m}"
    );
}

#[test]
fn behind_an_obstacle_it_moves_to_where_the_car_can_see_it() {
    let config = PlannerConfig::default();
    for (across_m, side) in [(0.6, 1.0), (-0.6, -1.0)] {
        let mut course = straight();
        course.put(32.0, 0.0, CAR);
        let state = state(&course, 20.0, across_m, 0.0);
        let observation = course.observe(&state, 0);
        let mut grid = Grid::new(&config);
        grid.fill(&observation);
        let goal_body = choose_goal(&grid, &config, &observation);
        assert!(
            grid.is_segment_free(Point::origin(), goal_body),
            "not in view"
        );
        let goal_across_m = course.place(state.pose() * goal_body).across_m;
        // On the side where the car is, or the planner changes its mind.
        assert!(
            goal_across_m * side > 1.0,
            "{goal_across_m} for a car at {across_m}"
        );
        assert!(goal_across_m.abs() <= ROAD_WIDTH_M / 2.0 - config.lane_margin_m + 1e-9);
    }
}
