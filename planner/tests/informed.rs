//! RRT* with a memory: what it keeps, what it forgets, and that it is no worse.

use planner::{Informed, Node, PlannerConfig, RrtStar};
use proptest::prelude::*;
use shm_config::config::Informed as Settings;
use shm_config::message::{Observation, Plan, PlanOutcome};
use vehicle::{Point, pose};

use crate::course::random_scene;
use crate::reference::{Dense, small_config, wild_observation};

/// Small planners; the inflation is the method's own.
fn small() -> impl Strategy<Value = (PlannerConfig, Settings)> {
    small_config().prop_map(|config| {
        let settings = Settings {
            inflation_m: config.inflation_m,
            ..Settings::default()
        };
        (config, settings)
    })
}

fn informed((config, settings): (PlannerConfig, Settings)) -> Informed {
    Informed::new(config, settings).unwrap()
}

fn plan(planner: &mut Informed, observation: &Observation) -> Plan {
    let mut plan = Plan::default();
    planner.plan(observation, &mut plan);
    plan
}

/// The same place a tick later, the car moved and turned; what the lidar sees
/// is another scene's.
fn later(observation: &Observation, seen: &Observation, moved: (f64, f64, f64)) -> Observation {
    let mut later = *seen;
    later.header = observation.header;
    later.header.tick += 1;
    later.header.taken_ns += 100_000_000;
    let ego = &observation.ego;
    let at =
        pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad) * pose(moved.0, moved.1, moved.2);
    later.ego.x_world_m = at.translation.x;
    later.ego.y_world_m = at.translation.y;
    later.ego.heading_world_rad = at.rotation.angle();
    later
}

/// The old path in the new body frame: the car, and the points still ahead, as
/// far as the way is free.
fn left_of(old: &Plan, new: &Observation, dense: &Dense) -> Vec<Point> {
    let (sin, cos) = new.ego.heading_world_rad.sin_cos();
    let mut points = vec![Point::origin()];
    let ahead = old.waypoints().iter().skip(1).map(|waypoint| {
        let world = old.world_from_plan() * waypoint.point();
        let (dx, dy) = (world.x - new.ego.x_world_m, world.y - new.ego.y_world_m);
        Point::new(cos * dx + sin * dy, cos * dy - sin * dx)
    });
    for point in ahead.skip_while(|point| point.x <= 0.0) {
        if !dense.is_free(*points.last().unwrap(), point) {
            break;
        }
        points.push(point);
    }
    points
}

fn length_m(points: &[Point]) -> f64 {
    points
        .windows(2)
        .map(|edge| (edge[1] - edge[0]).norm())
        .sum()
}

fn check_tree(planner: &Informed, plan: &Plan) -> Result<(), TestCaseError> {
    let dense = Dense::of(planner.grid());
    let nodes: Vec<Node> = planner.tree().nodes().collect();
    prop_assert!(nodes.len() <= 1 + planner.config().iterations as usize);
    for (index, node) in nodes.iter().enumerate().skip(1) {
        let parent = nodes[node.parent.unwrap()];
        let edge_m = (node.point_body - parent.point_body).norm();
        prop_assert!((parent.cost_m + edge_m - node.cost_m).abs() < 1e-9);
        prop_assert!(
            dense.is_free(parent.point_body, node.point_body),
            "edge to {}",
            index
        );
        let way = std::iter::successors(Some(index), |&at| nodes[at].parent).take(nodes.len() + 1);
        prop_assert_eq!(way.last(), Some(0));
    }
    let points: Vec<Point> = plan
        .waypoints()
        .iter()
        .map(|waypoint| waypoint.point())
        .collect();
    prop_assert!(points.len() == 64 || (length_m(&points) - plan.cost_m).abs() < 1e-9);
    prop_assert_eq!(shm_config::Message::check(plan), Ok(()));
    Ok(())
}

fn moves() -> impl Strategy<Value = (f64, f64, f64)> {
    (0.0..1.5, -0.3..0.3, -0.2..0.2f64)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn tree_and_path_are_sound_with_and_without_a_memory(
        config in small(), seed: u64, other: u64, moved in moves(),
    ) {
        let mut planner = informed(config);
        let first = wild_observation(seed);
        let answer = plan(&mut planner, &first);
        check_tree(&planner, &answer)?;
        let seen = wild_observation(if other % 2 == 0 { seed } else { other });
        let answer = plan(&mut planner, &later(&first, &seen, moved));
        check_tree(&planner, &answer)?;
    }

    /// Whatever is left of the old path and still leads to the goal: the new one
    /// is no longer.
    #[test]
    fn a_path_that_still_holds_is_not_exchanged_for_a_longer_one(
        config in small(), seed: u64, moved in moves(),
    ) {
        let mut planner = informed(config);
        let first = wild_observation(seed);
        let old = plan(&mut planner, &first);
        let second = later(&first, &first, moved);
        let new = plan(&mut planner, &second);
        let left = left_of(&old, &second, &Dense::of(planner.grid()));
        let goal = Point::new(new.goal_x_body_m, new.goal_y_body_m);
        let taken = planner.config().iterations as usize >= left.len();
        if taken {
            prop_assert_eq!(planner.warm_nodes(), left.len() - 1);
        }
        let radius_m = planner.config().goal_radius_m;
        for end in 1..=left.len() {
            let reaches = end > 1 && (left[end - 1] - goal).norm() <= radius_m - 1e-9;
            if taken && reaches {
                prop_assert_eq!(new.outcome(), PlanOutcome::Reached);
                prop_assert!(new.cost_m <= length_m(&left[..end]) + 1e-9);
            }
        }
    }

    #[test]
    fn the_same_observations_in_the_same_order_give_the_same_plans(
        config in small(), seeds in prop::collection::vec(any::<u64>(), 4), moved in moves(),
    ) {
        let mut planners = [informed(config), informed(config)];
        // One of them has seen something before.
        plan(&mut planners[1], &wild_observation(seeds[3]));
        planners[1].forget();
        let mut observation = wild_observation(seeds[0]);
        for seed in seeds {
            let [one, other] = planners.each_mut().map(|planner| plan(planner, &observation));
            prop_assert_eq!(format!("{one:?}"), format!("{other:?}"));
            observation = later(&observation, &wild_observation(seed), moved);
        }
    }

    /// An episode, a tick left out or seen twice, too long a pause, a clock that
    /// went back, and being told.
    #[test]
    fn it_forgets(config in small(), seed: u64, moved in moves(), why in 0..6) {
        let first = wild_observation(seed);
        let mut second = later(&first, &first, moved);
        let mut planner = informed(config);
        plan(&mut planner, &first);
        match why {
            0 => second.header.episode += 1,
            1 => second.header.tick += 1,
            2 => second.header.tick = first.header.tick,
            3 => second.header.taken_ns = first.header.taken_ns + 500_000_001,
            4 => {
                let mut late = first;
                late.header.taken_ns += 1_000_000_000;
                plan(&mut planner, &late);
            }
            _ => planner.forget(),
        }
        let used = plan(&mut planner, &second);
        prop_assert_eq!(planner.warm_nodes(), 0);
        let fresh = plan(&mut informed(config), &second);
        prop_assert_eq!(format!("{used:?}"), format!("{fresh:?}"));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// The samples do not depend on the budget.
    #[test]
    fn no_iteration_makes_a_node_dearer(config in small(), seed: u64) {
        let observation = wild_observation(seed);
        let mut before: Vec<Node> = Vec::new();
        for iterations in 1..=config.0.iterations.min(80) {
            let mut planner = informed((PlannerConfig { iterations, ..config.0 }, config.1));
            plan(&mut planner, &observation);
            let after: Vec<Node> = planner.tree().nodes().collect();
            for (before, after) in before.iter().zip(&after) {
                prop_assert_eq!(before.point_body, after.point_body);
                prop_assert!(after.cost_m <= before.cost_m);
            }
            prop_assert!(before.len() <= after.len());
            before = after;
        }
    }
}

/// Without any memory, on the same grid, with the same budget.
#[test]
fn its_paths_are_shorter_than_the_papers() {
    let settings = Settings::default();
    let config = PlannerConfig {
        inflation_m: settings.inflation_m,
        ..PlannerConfig::default()
    };
    let (mut paper, mut ours) = (RrtStar::new(config).unwrap(), informed((config, settings)));
    let (mut paper_m, mut ours_m, mut more, mut both) = (0.0, 0.0, 0, 0);
    for seed in 0..300 {
        let scene = random_scene(seed);
        let mut papers = Plan::default();
        paper.plan(&scene, &mut papers);
        ours.forget();
        let answer = plan(&mut ours, &scene);
        let reached = [&papers, &answer].map(|plan| plan.outcome() == PlanOutcome::Reached);
        more += usize::from(reached == [false, true]);
        if reached == [true, true] {
            both += 1;
            paper_m += papers.cost_m;
            ours_m += answer.cost_m;
        }
    }
    assert!(both > 200, "{both} of 300 goals were reached by both");
    assert!(
        ours_m < 0.99 * paper_m,
        "{ours_m} m against {paper_m} m, {more} more reached"
    );
}

/// On a free road the path is the straight line into the goal ball.
#[test]
fn an_empty_road_is_one_straight_line() {
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.ranges_m.fill(50.0);
    observation.road.left_m = 5.25;
    observation.road.right_m = 5.25;
    observation.checkpoints[0].x_body_m = 40.0;
    let mut planner = informed((PlannerConfig::default(), Settings::default()));
    let answer = plan(&mut planner, &observation);
    assert_eq!(
        (answer.outcome(), answer.iterations),
        (PlanOutcome::Reached, 200)
    );
    // 15 m less the goal ball of 1 m, in steps of 2 m.
    assert!(answer.cost_m < 14.0 + 1e-9, "{}", answer.cost_m);
}
