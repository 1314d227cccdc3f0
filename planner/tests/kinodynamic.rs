//! The tree over poses and its path: what must hold of them in any scene.

use planner::{Dubins, Kinodynamic, PoseNode};
use proptest::prelude::*;
use shm_config::config::{Config, Kinodynamic as Settings};
use shm_config::message::{Observation, Plan, PlanOutcome};
use vehicle::{Point, Pose, State, Vehicle, pose, wrap_rad};

use crate::course::{self, Course, Road};
use crate::reference::{Dense, small_config, wild_observation};

/// A car small enough for small grids, now and then, and one speed only.
fn wild_config() -> impl Strategy<Value = Config> {
    let car = (0.5..3.0, 0.3..1.5, 0.4..2.5, 20.0..60.0f64);
    let drive = (0.0..0.4, 0.0..1.5, 0.5..6.0, 2.0..12.0, 0.0..0.5);
    (small_config(), car, drive).prop_map(|(planner, car, drive)| {
        let speed_mps = 3.0;
        Config {
            planner: planner::PlannerConfig {
                speed_mps,
                ..planner
            },
            vehicle: Vehicle {
                length_m: car.0,
                width_m: car.1,
                wheelbase_m: car.2,
                max_steer_deg: car.3,
                ..Vehicle::default()
            },
            kinodynamic: Settings {
                clearance_m: drive.0,
                lane_margin_m: drive.1,
                lateral_mps2: drive.2,
                slow_mps: speed_mps,
                goal_distance_m: drive.3 + 1.0,
                reach_m: drive.3,
                uniform_share: drive.4,
                ..Settings::default()
            },
            ..Config::default()
        }
    })
}

fn planned(config: &Config, observation: &Observation) -> (Kinodynamic, Plan) {
    let mut planner = Kinodynamic::new(config).unwrap();
    let mut plan = Plan::default();
    planner.plan(observation, &mut plan);
    (planner, plan)
}

fn edges(planner: &Kinodynamic) -> Vec<(PoseNode, PoseNode, Dubins)> {
    let nodes: Vec<PoseNode> = planner.nodes().collect();
    let edge = |node: &PoseNode| {
        let parent = nodes[node.parent?];
        let curve = Dubins::shortest(
            &parent.body_from_node,
            &node.body_from_node,
            planner.radius_m(),
        );
        Some((parent, *node, curve))
    };
    nodes.iter().filter_map(edge).collect()
}

/// Whether a place in the dense grid is free; outside it is not.
fn is_free(dense: &Dense, place: Point) -> bool {
    // What lies on the line between two cells is in both.
    let near = [-1e-9, 1e-9]
        .into_iter()
        .flat_map(|x| [-1e-9, 1e-9].map(|y| (x, y)));
    near.into_iter().any(|(x, y)| {
        let column = ((place.x + x) / dense.cell_m).floor();
        let row = ((place.y + y + dense.y_max_m) / dense.cell_m).floor();
        column >= 0.0
            && row >= 0.0
            && dense
                .cells
                .get(row as usize)
                .is_some_and(|cells| cells.get(column as usize).is_some_and(|occupied| !occupied))
    })
}

/// Every edge is a curve that costs its length, and is free, point for point.
fn check_tree(planner: &Kinodynamic) -> Result<(), TestCaseError> {
    let dense = Dense::of(planner.grid());
    let nodes: Vec<PoseNode> = planner.nodes().collect();
    prop_assert_eq!(nodes[0].body_from_node, Pose::identity());
    prop_assert_eq!((nodes[0].parent, nodes[0].cost_m), (None, 0.0));
    let edges = edges(planner);
    prop_assert_eq!(edges.len() + 1, nodes.len());
    for (parent, node, curve) in &edges {
        prop_assert!((parent.cost_m + curve.length_m() - node.cost_m).abs() < 1e-9);
        let end = curve.at(&parent.body_from_node, curve.length_m());
        let missed = end.translation.vector - node.body_from_node.translation.vector;
        prop_assert!(missed.norm() < 1e-6);
        let steps = (curve.length_m() / dense.cell_m * 20.0) as usize + 1;
        for step in 0..=steps {
            let along_m = curve.length_m() * step as f64 / steps as f64;
            let at = curve.at(&parent.body_from_node, along_m);
            for ahead_m in planner.body_ahead_m() {
                let place = at * Point::new(ahead_m, 0.0);
                prop_assert!(is_free(&dense, place), "{} of {:?}", place, curve);
            }
        }
    }
    for index in 0..nodes.len() {
        let way = std::iter::successors(Some(index), |&at| nodes[at].parent).take(nodes.len() + 1);
        prop_assert_eq!(way.last(), Some(0), "node {} is in a circle", index);
    }
    Ok(())
}

/// The path is a way of the tree, begins as the car stands, and can be driven.
fn check_path(
    planner: &Kinodynamic,
    plan: &Plan,
    settings: &Settings,
) -> Result<(), TestCaseError> {
    prop_assert_eq!(shm_config::Message::check(plan), Ok(()));
    let points: Vec<Point> = plan
        .waypoints()
        .iter()
        .map(|waypoint| waypoint.point())
        .collect();
    if plan.outcome() == PlanOutcome::Blocked {
        prop_assert!(points.is_empty() && plan.cost_m == 0.0);
        return Ok(());
    }
    prop_assert_eq!(points[0], Point::origin());
    let end = *points.last().unwrap();
    let nodes: Vec<PoseNode> = planner.nodes().collect();
    let ends_here = |node: &PoseNode| {
        (node.body_from_node * Point::origin() - end).norm() < 1e-6
            && (node.cost_m - plan.cost_m).abs() < 1e-6
    };
    prop_assert!(nodes.iter().any(ends_here));
    let apart_m = plan.cost_m / (points.len() - 1) as f64;
    // The direction between neighbours turns no faster than the radius allows,
    // from the car's own heading on.
    let most_rad = apart_m / planner.radius_m();
    let mut heading_rad = 0.0;
    for (index, edge) in points.windows(2).enumerate() {
        let way = edge[1] - edge[0];
        prop_assert!(way.norm() <= apart_m + 1e-6);
        if most_rad < 1.0 {
            let turn_rad = wrap_rad(way.y.atan2(way.x) - heading_rad).abs();
            let share = if index == 0 { 0.5 } else { 1.0 };
            prop_assert!(
                turn_rad <= share * most_rad + 1e-5,
                "{} of {}",
                turn_rad,
                most_rad
            );
            heading_rad = way.y.atan2(way.x);
        }
    }
    let waypoints = plan.waypoints();
    for pair in waypoints.windows(2) {
        let (now, next) = (pair[0].speed_mps, pair[1].speed_mps);
        prop_assert!(now * now <= next * next + 2.0 * settings.brake_mps2 * apart_m + 1e-6);
        prop_assert!(now <= planner.config().speed_mps);
    }
    let last_mps = waypoints.last().unwrap().speed_mps;
    prop_assert_eq!(last_mps == 0.0, plan.outcome() == PlanOutcome::Partial);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn tree_and_path_are_sound_in_wild_scenes(config in wild_config(), seed: u64) {
        let observation = wild_observation(seed);
        let (planner, plan) = planned(&config, &observation);
        check_tree(&planner)?;
        check_path(&planner, &plan, &config.kinodynamic)?;
    }

    /// Also of a planner that has planned something else before.
    #[test]
    fn the_same_observation_gives_the_same_plan(config in wild_config(), seed: u64, other: u64) {
        let observation = wild_observation(seed);
        let (mut planner, first) = planned(&config, &observation);
        let mut second = Plan::default();
        planner.plan(&wild_observation(other), &mut second);
        planner.plan(&observation, &mut second);
        prop_assert_eq!(format!("{first:?}"), format!("{second:?}"));
    }

    #[test]
    fn numbers_that_are_none_do_not_stop_it(seed: u64, which in 0usize..8) {
        let mut observation = wild_observation(seed);
        let bad = if seed % 2 == 0 { f64::NAN } else { f64::INFINITY };
        match which {
            0 => observation.road.left_m = bad,
            1 => observation.road.right_m = bad,
            2 => observation.road.heading_rad = bad,
            3 => observation.checkpoints[0].x_body_m = bad,
            4 => observation.checkpoints[1].y_body_m = bad,
            5 => observation.ranges_m.fill(bad as f32),
            6 => observation.lidar_max_m = bad as f32,
            _ => observation.beam_count = u32::MAX,
        }
        let mut config = Config::default();
        config.planner.iterations = 20;
        let (_, plan) = planned(&config, &observation);
        prop_assert_eq!(shm_config::Message::check(&plan), Ok(()));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// The samples do not depend on the budget.
    #[test]
    fn no_iteration_makes_a_node_dearer(config in wild_config(), seed: u64) {
        let observation = wild_observation(seed);
        let mut before: Vec<PoseNode> = Vec::new();
        for iterations in 1..=config.planner.iterations.min(60) {
            let mut config = config.clone();
            config.planner.iterations = iterations;
            let after: Vec<PoseNode> = planned(&config, &observation).0.nodes().collect();
            for (before, after) in before.iter().zip(&after) {
                prop_assert_eq!(before.body_from_node, after.body_from_node);
                prop_assert!(after.cost_m <= before.cost_m);
            }
            prop_assert!(before.len() <= after.len());
            before = after;
        }
    }
}

#[test]
fn tree_and_path_are_sound_on_the_road() {
    let config = Config::default();
    let mut reached = 0;
    for seed in 0..150 {
        let (planner, plan) = planned(&config, &course::random_scene(seed));
        check_tree(&planner).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        check_path(&planner, &plan, &config.kinodynamic)
            .unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        reached += usize::from(plan.outcome() == PlanOutcome::Reached);
    }
    assert!(reached > 100, "only {reached} of 150 goals were reached");
}

/// The corridor on the grid is the road's, in bends, too: each cell asks the
/// course where it is.
#[test]
fn the_corridor_bends_as_the_road_does() {
    let config = Config::default();
    let (mut free, mut occupied) = (0, 0);
    for radius_m in [14.0f64, -14.0, 25.0, -40.0, 60.0] {
        let roads = [30.0, 1.2 * radius_m.abs(), 60.0].map(|length_m| Road {
            length_m,
            curvature_per_m: 0.0,
        });
        let mut roads = roads;
        roads[1].curvature_per_m = 1.0 / radius_m;
        let course = Course::new(&roads);
        for along_m in [12.0, 26.0, 31.0, 36.0] {
            let world_from_body = course.pose_at(along_m) * pose(0.0, 0.7, 0.1);
            let state = State {
                position: world_from_body.translation.vector.into(),
                heading_rad: world_from_body.rotation.angle(),
                speed_mps: 5.0,
            };
            let (planner, _) = planned(&config, &course.observe(&state, 0));
            let grid = planner.grid();
            let half_m = course::ROAD_WIDTH_M / 2.0 - config.kinodynamic.lane_margin_m;
            for (row, column) in (0..grid.rows()).step_by(9).flat_map(|row| {
                (0..grid.columns())
                    .step_by(9)
                    .map(move |column| (row, column))
            }) {
                let cell = planner::Cell { column, row };
                let place = course.place(state.pose() * grid.cell_middle(cell));
                // Far ahead, the second checkpoint's road is all that is known.
                if place.along_m > along_m + 40.0 || (place.across_m.abs() - half_m).abs() < 0.05 {
                    continue;
                }
                let outside = place.across_m.abs() > half_m;
                assert_eq!(
                    grid.is_occupied(cell),
                    outside,
                    "radius {radius_m} at {along_m}: {place:?}"
                );
                *(if outside { &mut occupied } else { &mut free }) += 1;
            }
        }
    }
    assert!(free > 2000 && occupied > 5000, "{free} {occupied}");
}

#[test]
fn the_turning_circle_is_the_cars_or_that_of_the_speed() {
    let planner = Kinodynamic::new(&Config::default()).unwrap();
    let own_m = 2.469 / 40f64.to_radians().tan();
    assert!((planner.turning_radius_m(0.0) - own_m).abs() < 1e-9);
    assert!((planner.turning_radius_m(5.0) - 6.25).abs() < 1e-9);
}

#[test]
fn an_empty_road_is_one_curve_to_its_middle() {
    let course = Course::new(&[Road {
        length_m: 100.0,
        curvature_per_m: 0.0,
    }]);
    let state = State {
        position: Point::new(20.0, 1.0),
        heading_rad: 0.0,
        speed_mps: 5.0,
    };
    let (planner, plan) = planned(&Config::default(), &course.observe(&state, 0));
    assert_eq!(plan.outcome(), PlanOutcome::Reached);
    assert!((plan.goal_y_body_m + 1.0).abs() < 0.01);
    let shortest = Dubins::shortest(
        &Pose::identity(),
        &pose(plan.goal_x_body_m, plan.goal_y_body_m, 0.0),
        planner.radius_m(),
    );
    assert!((plan.cost_m - shortest.length_m()).abs() < 1e-3);
    // No chain of curves is shorter than the one curve: nothing is looked for.
    assert_eq!((plan.iterations, plan.nodes), (0, 2));
}

/// Neither the fast nor the slow car finds a way; together they take one budget.
#[test]
fn a_closed_road_takes_one_budget() {
    let mut course = Course::new(&[Road {
        length_m: 100.0,
        curvature_per_m: 0.0,
    }]);
    for across_m in [-3.5, 0.0, 3.5] {
        course.put(34.0, across_m, course::CAR);
    }
    let state = State {
        position: Point::new(20.0, 0.0),
        heading_rad: 0.0,
        speed_mps: 5.0,
    };
    let config = Config::default();
    let (planner, plan) = planned(&config, &course.observe(&state, 0));
    assert_eq!(plan.outcome(), PlanOutcome::Partial);
    assert_eq!(plan.iterations, config.planner.iterations);
    let slow_m = planner.turning_radius_m(config.kinodynamic.slow_mps);
    assert_eq!(planner.radius_m(), slow_m);
}

/// Whatever the scene, no plan takes more than a budget and the quarter of one
/// in which the fast car found nothing.
#[test]
fn a_plan_takes_a_budget_and_a_quarter_at_most() {
    let config = Config::default();
    let (mut most, mut none) = (0, 0);
    for seed in 0..300 {
        let (_, plan) = planned(&config, &course::random_scene(seed));
        most = most.max(plan.iterations);
        none += usize::from(plan.iterations == 0);
    }
    let budget = config.planner.iterations;
    assert!((budget..=budget + budget / 4).contains(&most), "{most}");
    assert!(none > 50, "only {none} of 300 goals are one curve away");
}
