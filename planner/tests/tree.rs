//! The tree of RRT* against one grown by the book, and what must hold of it.

use planner::{Node, PlannerConfig, RrtStar};
use proptest::prelude::*;
use shm_config::message::{Observation, Plan, PlanOutcome};
use vehicle::Point;

use crate::course;
use crate::reference::{self, Dense, slow_tree, small_config, wild_observation};

fn planned(config: PlannerConfig, observation: &Observation) -> (RrtStar, Plan) {
    let mut planner = RrtStar::new(config).unwrap();
    let mut plan = Plan::default();
    planner.plan(observation, &mut plan);
    (planner, plan)
}

fn goal(plan: &Plan) -> Point {
    Point::new(plan.goal_x_body_m, plan.goal_y_body_m)
}

/// Node for node and bit for bit.
fn same_as_by_the_book(config: PlannerConfig, observation: &Observation, dense: &Dense) -> usize {
    let (planner, plan) = planned(config, observation);
    let slow = slow_tree(&config, observation, dense, goal(&plan));
    assert_eq!(plan.nodes as usize, slow.len());
    for (index, (node, other)) in planner.tree().nodes().zip(&slow).enumerate() {
        assert_eq!(node.point_body, other.point, "node {index}");
        assert_eq!(node.parent, other.parent, "node {index}");
        assert_eq!(node.cost_m, reference::cost_m(&slow, index), "node {index}");
    }
    slow.len()
}

/// Edges are free, costs are their sums, every node hangs on the start.
fn check_tree(planner: &RrtStar, dense: &Dense) -> Result<(), TestCaseError> {
    let config = planner.config();
    let nodes: Vec<Node> = planner.tree().nodes().collect();
    prop_assert_eq!(nodes[0].point_body, Point::origin());
    prop_assert_eq!((nodes[0].parent, nodes[0].cost_m), (None, 0.0));
    for (index, node) in nodes.iter().enumerate().skip(1) {
        prop_assert!(
            node.point_body
                .coords
                .iter()
                .all(|number| number.is_finite())
        );
        let parent = nodes[node.parent.unwrap()];
        let edge_m = (node.point_body - parent.point_body).norm();
        prop_assert!(edge_m <= config.rewire_radius_m.max(config.step_m) + 1e-9);
        prop_assert!(
            (parent.cost_m + edge_m - node.cost_m).abs() < 1e-9,
            "cost of {}",
            index
        );
        prop_assert!(
            dense.is_free(parent.point_body, node.point_body),
            "edge to {}",
            index
        );
        let way = std::iter::successors(Some(index), |&at| nodes[at].parent).take(nodes.len() + 1);
        prop_assert_eq!(way.last(), Some(0), "node {} is in a circle", index);
    }
    Ok(())
}

/// The path is a way of the tree, to the right node.
fn check_path(planner: &RrtStar, plan: &Plan, dense: &Dense) -> Result<(), TestCaseError> {
    let config = planner.config();
    let nodes: Vec<Node> = planner.tree().nodes().collect();
    let to_goal_m = |point: Point| (point - goal(plan)).norm();
    let best = nodes
        .iter()
        .filter(|node| to_goal_m(node.point_body) <= config.goal_radius_m)
        .map(|node| node.cost_m)
        .min_by(f64::total_cmp);
    let points: Vec<Point> = plan
        .waypoints()
        .iter()
        .map(|waypoint| waypoint.point())
        .collect();
    match plan.outcome() {
        PlanOutcome::Reached => prop_assert_eq!(Some(plan.cost_m), best),
        PlanOutcome::Partial => {
            prop_assert_eq!(best, None);
            let end = *points.last().unwrap();
            prop_assert!(
                nodes
                    .iter()
                    .all(|node| to_goal_m(node.point_body) >= to_goal_m(end))
            );
            prop_assert!(end.coords.norm() >= config.partial_min_m);
        }
        PlanOutcome::Blocked => {
            prop_assert_eq!((best, plan.cost_m), (None, 0.0));
            prop_assert!(points.is_empty());
            return Ok(());
        }
    }
    prop_assert_eq!(points[0], Point::origin());
    let length_m: f64 = points
        .windows(2)
        .map(|edge| (edge[1] - edge[0]).norm())
        .sum();
    prop_assert!(points.len() == 64 || (length_m - plan.cost_m).abs() < 1e-9);
    for edge in points.windows(2) {
        prop_assert!(
            dense.is_free(edge[0], edge[1]),
            "{} to {}",
            edge[0],
            edge[1]
        );
    }
    prop_assert!(
        plan.waypoints()
            .iter()
            .all(|waypoint| waypoint.speed_mps == config.speed_mps)
    );
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn tree_and_path_are_sound_in_wild_scenes(config in small_config(), seed: u64) {
        let observation = wild_observation(seed);
        let (planner, plan) = planned(config, &observation);
        let dense = Dense::of(planner.grid());
        check_tree(&planner, &dense)?;
        check_path(&planner, &plan, &dense)?;
        prop_assert_eq!(shm_config::Message::check(&plan), Ok(()));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_wild_tree_is_the_one_of_the_book(config in small_config(), seed: u64) {
        let observation = wild_observation(seed);
        same_as_by_the_book(config, &observation, &Dense::new(&config, &observation));
    }

    /// The samples do not depend on the budget, so the tree after n iterations
    /// is the beginning of the one after n + 1.
    #[test]
    fn no_iteration_makes_a_node_dearer(config in small_config(), seed: u64) {
        let observation = wild_observation(seed);
        let mut before: Vec<Node> = Vec::new();
        for iterations in 1..=config.iterations.min(80) {
            let (planner, _) = planned(PlannerConfig { iterations, ..config }, &observation);
            let after: Vec<Node> = planner.tree().nodes().collect();
            prop_assert!(after.len() - before.len() <= 1 + usize::from(before.is_empty()));
            for (before, after) in before.iter().zip(&after) {
                prop_assert_eq!(before.point_body, after.point_body);
                prop_assert!(after.cost_m <= before.cost_m);
            }
            before = after;
        }
    }
}

#[test]
fn the_papers_tree_is_the_one_of_the_book() {
    let config = PlannerConfig::default();
    let mut planner = RrtStar::new(config).unwrap();
    let nodes: usize = (0..25)
        .map(|seed| {
            let observation = course::random_scene(seed);
            planner.plan(&observation, &mut Plan::default());
            same_as_by_the_book(config, &observation, &Dense::of(planner.grid()))
        })
        .sum();
    assert!(
        nodes > 25 * 150,
        "{nodes} nodes: the scenes are hardly free"
    );
}

#[test]
fn tree_and_path_are_sound_on_the_road() {
    let mut reached = 0;
    for seed in 0..300 {
        let (planner, plan) = planned(PlannerConfig::default(), &course::random_scene(seed));
        let dense = Dense::of(planner.grid());
        check_tree(&planner, &dense).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        check_path(&planner, &plan, &dense).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        reached += usize::from(plan.outcome() == PlanOutcome::Reached);
    }
    assert!(reached > 250, "only {reached} of 300 goals were reached");
}

/// Rewiring matters: without it (a radius that holds no node) paths are longer.
#[test]
fn rewiring_makes_paths_shorter() {
    let mean_m = |rewire_radius_m: f64| {
        let config = PlannerConfig {
            rewire_radius_m,
            ..PlannerConfig::default()
        };
        let costs: Vec<f64> = (0..200)
            .map(|seed| planned(config, &course::random_scene(seed)).1)
            .filter(|plan| plan.outcome() == PlanOutcome::Reached)
            .map(|plan| plan.cost_m)
            .collect();
        costs.iter().sum::<f64>() / costs.len() as f64
    };
    let (with_m, without_m) = (mean_m(3.0), mean_m(0.05));
    assert!(
        with_m < 0.95 * without_m,
        "{with_m} m against {without_m} m"
    );
}
