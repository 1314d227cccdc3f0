//! The memory of a plan of the model-predictive expert. Its solver is a library that
//! allocates for each solution; nothing else in a plan may allocate.

use allocation_counter::measure;
use planner::Planner;
use shm_config::config::planner::Method;
use shm_config::config::{Clock, Config};
use shm_config::message::{Observation, Plan};
use sim::{World, WorldConfig};
use vehicle::Action;

const PLANS: u64 = 200;
const WARM_UP: u64 = 5;
/// The count of the solver alone; a larger count means that other code of a plan
/// allocates.
const ALLOCATIONS_MAX: u64 = 4;

#[test]
fn a_plan_takes_no_more_memory_than_its_solver() {
    let mut config = Config::default();
    config.planner.method = Method::Mpc;
    config.run.clock = Clock::Lockstep;
    let mut world = World::new(WorldConfig::default()).expect("a world");
    world.reset(100).expect("a map");
    let mut planner = Planner::new(&config).expect("a planner");
    let (mut observation, mut plan) = (Box::<Observation>::default(), Box::<Plan>::default());
    let (mut most, mut all, mut bytes, mut held) = (0, 0, 0, 0);
    for tick in 0..PLANS + WARM_UP {
        world.observe(&mut observation);
        observation.header.tick = tick;
        observation.header.taken_ns = tick * 100_000_000;
        let taken = measure(|| planner.plan(&observation, &mut plan));
        if tick >= WARM_UP {
            most = most.max(taken.count_total);
            all += taken.count_total;
            bytes += taken.bytes_total;
            held += taken.bytes_current;
        }
        world.step(plan.action_at(0).unwrap_or(Action::BRAKE));
    }
    println!(
        "allocations of a plan: {:.1} mean, {most} at most; {} bytes mean",
        all as f64 / PLANS as f64,
        bytes / PLANS
    );
    assert!(world.driven_m() > 50.0, "it drove");
    assert!(most <= ALLOCATIONS_MAX, "{most} allocations in one plan");
    assert_eq!(held, 0, "bytes that were not given back");
}
