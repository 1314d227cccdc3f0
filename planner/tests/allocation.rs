//! A plan takes no memory and gives none back.

mod course;

use std::hint::black_box;

use allocation_counter::measure;
use planner::Planner;
use shm_config::config::Config;
use shm_config::config::planner::Method;
use shm_config::message::{Observation, Plan, PlanOutcome};

#[test]
fn no_plan_allocates() {
    let control = measure(|| drop(black_box(vec![1u8; 100])));
    assert_eq!(control.count_total, 1, "the counter counts");
    for method in [Method::RrtStar, Method::Informed, Method::Kinodynamic] {
        no_plan_of_a_method_allocates(method);
    }
}

fn no_plan_of_a_method_allocates(method: Method) {
    let scenes: Vec<Observation> = (0..200).map(course::random_scene).collect();
    let mut config = Config::default();
    config.planner.method = method;
    let mut planner = Planner::new(&config).unwrap();
    let mut plan = Plan::default();
    let mut tick = 0;
    let (mut reached, mut partial, mut nodes, mut waypoints) = (0, 0, 0, 0);
    for round in 0..10 {
        for scene in &scenes {
            let mut observation = *scene;
            // One after the other: a method with a memory uses it.
            tick += 1;
            observation.header.tick = tick;
            // The beams' directions change with their number.
            observation.beam_count -= (round % 2) as u32 * 120;
            let taken = measure(|| planner.plan(&observation, &mut plan));
            assert_eq!(
                (taken.count_total, taken.count_current),
                (0, 0),
                "{method:?}"
            );
            reached += usize::from(plan.outcome() == PlanOutcome::Reached);
            partial += usize::from(plan.outcome() == PlanOutcome::Partial);
            nodes += plan.nodes;
            waypoints += plan.waypoint_count;
        }
    }
    // 2,000 plans that were plans.
    assert!(
        reached > 1500 && partial >= 10,
        "{method:?}: {reached} reached, {partial} partial"
    );
    // Where a curve leads straight to the goal, nothing else can help.
    let least = match method {
        Method::Kinodynamic => 2,
        Method::RrtStar | Method::Informed | Method::Mpc => 150,
    };
    assert!(nodes > 2000 * least, "{method:?}: {nodes} nodes");
    assert!(waypoints > 2000 * 4, "{waypoints} waypoints");
}
