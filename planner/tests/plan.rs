//! What a plan says, and that it depends on its observation alone.

use planner::{PlannerConfig, RrtStar};
use proptest::prelude::*;
use shm_config::message::{Observation, Plan, PlanOutcome, Waypoint};

use crate::reference::{small_config, wild_observation};

fn planner() -> RrtStar {
    RrtStar::new(PlannerConfig::default()).unwrap()
}

/// A straight road of 10.5 m, the car in its middle, walls as told.
fn straight(range_m: impl Fn(f64) -> f64) -> Observation {
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    for (beam, range) in observation.ranges_m[..240].iter_mut().enumerate() {
        *range = range_m((1.5 * beam as f64).to_radians()).min(50.0) as f32;
    }
    observation.road.left_m = 5.25;
    observation.road.right_m = 5.25;
    observation.checkpoints[0].x_body_m = 40.0;
    observation.checkpoints[1].x_body_m = 80.0;
    observation
}

/// A wall across the whole road, this far ahead.
fn wall(ahead_m: f64) -> Observation {
    straight(|angle_rad| {
        if angle_rad.cos() > 0.1 {
            ahead_m / angle_rad.cos()
        } else {
            50.0
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_same_observation_gives_the_same_plan(config in small_config(), seed: u64, other: u64) {
        let observation = wild_observation(seed);
        let mut fresh = RrtStar::new(config).unwrap();
        let (mut first, mut second) = (Plan::default(), Plan::default());
        fresh.plan(&observation, &mut first);
        // One that has planned something else before.
        fresh.plan(&wild_observation(other), &mut second);
        let mut used = fresh;
        used.plan(&observation, &mut second);
        prop_assert_eq!(format!("{first:?}"), format!("{second:?}"));
    }

    /// The door keeps such observations out; the planner must live through them.
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
        let mut plan = Plan::default();
        planner().plan(&observation, &mut plan);
        prop_assert!(plan.waypoints().iter().all(|waypoint| waypoint.x_body_m.is_finite()
            && waypoint.y_body_m.is_finite()));
    }
}

#[test]
fn ticks_episodes_and_seeds_have_streams_of_their_own() {
    let base = straight(|_| 50.0);
    let mut tick = base;
    tick.header.tick = 1;
    let mut episode = base;
    episode.header.episode = 1;
    let seeded = PlannerConfig {
        seed: 1,
        ..PlannerConfig::default()
    };
    let mut other = RrtStar::new(seeded).unwrap();
    let first = |planner: &mut RrtStar, observation: &Observation| {
        planner.plan(observation, &mut Plan::default());
        planner.tree().node(1).unwrap().point_body
    };
    let points = [
        first(&mut planner(), &base),
        first(&mut planner(), &tick),
        first(&mut planner(), &episode),
        first(&mut other, &base),
    ];
    for (index, point) in points.iter().enumerate() {
        assert!(!points[..index].contains(point), "{points:?}");
    }
}

#[test]
fn the_header_and_the_origin_are_the_observations() {
    let mut observation = straight(|_| 50.0);
    observation.header.tick = 17;
    observation.header.taken_ns = 1234;
    observation.header.episode = 3;
    observation.header.sequence = 99;
    observation.header.producer = 99;
    observation.ego.x_world_m = 100.0;
    observation.ego.y_world_m = -50.0;
    observation.ego.heading_world_rad = 0.7;
    let mut plan = Plan {
        planning_ns: 5,
        ..Plan::default()
    };
    plan.header.sequence = 7;
    plan.header.producer = 8;
    planner().plan(&observation, &mut plan);
    let header = plan.header;
    assert_eq!(
        (header.tick, header.taken_ns, header.episode),
        (17, 1234, 3)
    );
    // The caller's own are left alone.
    assert_eq!(
        (header.sequence, header.producer, plan.planning_ns),
        (7, 8, 5)
    );
    assert_eq!(plan.world_from_plan(), vehicle::pose(100.0, -50.0, 0.7));
    assert_eq!(
        (plan.iterations, plan.outcome()),
        (200, PlanOutcome::Reached)
    );
    assert!(plan.nodes > 150 && plan.waypoint_count > 2);
}

#[test]
fn a_wall_far_ahead_leaves_a_path_that_ends_before_it() {
    let mut plan = Plan::default();
    planner().plan(&wall(12.0), &mut plan);
    assert_eq!(plan.outcome(), PlanOutcome::Partial);
    let end = plan.waypoints().last().unwrap();
    assert!(end.x_body_m > 8.0 && end.x_body_m < 11.5, "{end:?}");
}

#[test]
fn a_wall_right_ahead_leaves_no_path_and_nothing_of_the_last_one() {
    let mut planner = planner();
    let mut plan = Plan::default();
    planner.plan(&straight(|_| 50.0), &mut plan);
    assert!(plan.waypoint_count > 0 && plan.cost_m > 10.0);
    planner.plan(&wall(3.5), &mut plan);
    assert_eq!(plan.outcome(), PlanOutcome::Blocked);
    assert_eq!((plan.waypoint_count, plan.cost_m), (0, 0.0));
    assert!(
        plan.waypoints
            .iter()
            .all(|waypoint| *waypoint == Waypoint::default())
    );
}

#[test]
fn of_a_path_too_long_the_first_points_are_kept() {
    let config = PlannerConfig {
        step_m: 0.1,
        rewire_radius_m: 0.1,
        iterations: 4000,
        goal_distance_m: 12.0,
        goal_bias: 1.0,
        ..PlannerConfig::default()
    };
    let mut planner = RrtStar::new(config).unwrap();
    let mut plan = Plan::default();
    planner.plan(&straight(|_| 50.0), &mut plan);
    assert_eq!(
        (plan.outcome(), plan.waypoint_count),
        (PlanOutcome::Reached, 64)
    );
    let last = plan.waypoints().last().unwrap();
    assert!(
        (last.x_body_m - 6.3).abs() < 1e-6,
        "63 steps of 0.1 m, not {}",
        last.x_body_m
    );
    assert!(
        (plan.cost_m - 11.0).abs() < 0.2,
        "the cost is of the whole path"
    );
}

fn with_waypoints(points: &[(f64, f64)]) -> Plan {
    let mut plan = Plan {
        waypoint_count: points.len() as u32,
        ..Plan::default()
    };
    for (waypoint, &(x_body_m, y_body_m)) in plan.waypoints.iter_mut().zip(points) {
        *waypoint = Waypoint {
            x_body_m,
            y_body_m,
            speed_mps: 5.0,
        };
    }
    plan
}

#[test]
fn the_lookahead_is_the_nearest_waypoint_far_enough_away() {
    let here = vehicle::Pose::identity();
    let x_m = |plan: &Plan| plan.lookahead(&here, 2.0).map(|(point, _)| point.x);
    // By distance, not by order along the path: this one turns back.
    let winding = with_waypoints(&[(0.0, 0.0), (1.9, 0.0), (3.0, 2.0), (2.5, 0.0), (6.0, 0.0)]);
    assert_eq!(x_m(&winding), Some(2.5));
    assert_eq!(
        x_m(&with_waypoints(&[(0.0, 0.0), (2.0, 0.0), (4.0, 0.0)])),
        Some(2.0)
    );
    // All too near: the last.
    assert_eq!(
        x_m(&with_waypoints(&[(0.0, 0.0), (1.5, 0.0), (1.0, 0.0)])),
        Some(1.0)
    );
    assert_eq!(x_m(&with_waypoints(&[])), None);
}
