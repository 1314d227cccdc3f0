//! Model-predictive control, by how it drives and by what it answers when things
//! go wrong.

use planner::{Mpc, Planner};
use shm_config::Message;
use shm_config::config::planner::Method;
use shm_config::config::{Clock, Config};
use shm_config::message::{Observation, Plan, PlanOutcome};
use vehicle::{Action, State, Vehicle, pose, step};

use crate::course::driver::random_course;
use crate::course::{CAR, Course, Dice, ROAD_WIDTH_M, Road, random_scene};

const STEP_S: f64 = 0.1;

fn config() -> Config {
    let mut config = Config::default();
    config.planner.method = Method::Mpc;
    // No limit of time: a test must not depend on the machine.
    config.run.clock = Clock::Lockstep;
    config
}

fn mpc() -> Mpc {
    Mpc::new(&config())
}

/// The observation at a tick, with the time that the filters go by.
fn at_tick(mut observation: Observation, tick: u64) -> Observation {
    observation.header.tick = tick;
    observation.header.taken_ns = tick * 100_000_000;
    observation
}

struct Drive {
    state: State,
    along_m: f64,
    clearance_m: f64,
    edge_m: f64,
    arrived: bool,
}

/// Drives a course with the plans' first actions.
fn drive(course: &Course, ticks: u64) -> Drive {
    let vehicle = Vehicle::default();
    let mut planner = mpc();
    let mut plan = Plan::default();
    let start = course.pose_at(5.0);
    let mut drive = Drive {
        state: State {
            position: start.translation.vector.into(),
            heading_rad: start.rotation.angle(),
            speed_mps: 0.0,
        },
        along_m: 0.0,
        clearance_m: f64::INFINITY,
        edge_m: f64::INFINITY,
        arrived: false,
    };
    let mut last = Action::default();
    for tick in 0..ticks {
        let place = course.place(drive.state.position);
        drive.along_m = place.along_m;
        drive.edge_m = drive.edge_m.min(ROAD_WIDTH_M / 2.0 - place.across_m.abs());
        let clearance_m = course.clearance_m(&vehicle, &drive.state.pose());
        drive.clearance_m = drive.clearance_m.min(clearance_m);
        drive.arrived = place.along_m > course.length_m() - 5.0;
        if drive.arrived {
            break;
        }
        let mut observation = at_tick(course.observe(&drive.state, tick), tick);
        (observation.ego.steer, observation.ego.pedal) = (last.steer, last.pedal);
        let steer_rad = last.control(&vehicle).steer_rad;
        observation.ego.yaw_rate_radps =
            drive.state.speed_mps * steer_rad.tan() / vehicle.wheelbase_m;
        planner.plan(&observation, &mut plan);
        assert_eq!(plan.check(), Ok(()), "tick {tick}");
        last = plan.action_at(0).expect("an action");
        drive.state = step(&vehicle, &drive.state, last.control(&vehicle), STEP_S);
    }
    drive
}

#[test]
fn drives_bends_and_passes_obstacles_without_touching_them() {
    for seed in 0..4 {
        let drive = drive(&random_course(seed, true), 900);
        assert!(drive.arrived, "seed {seed}: {:.1} m", drive.along_m);
        assert!(
            drive.clearance_m > 0.05,
            "seed {seed}: {:.2} m",
            drive.clearance_m
        );
        assert!(drive.edge_m > 0.9, "seed {seed}: {:.2} m", drive.edge_m);
    }
}

#[test]
fn stops_before_a_road_that_is_blocked() {
    let mut course = Course::new(&[Road {
        length_m: 200.0,
        curvature_per_m: 0.0,
    }]);
    for across_m in [-4.0, -2.0, 0.0, 2.0, 4.0] {
        course.put(70.0, across_m, CAR);
    }
    let drive = drive(&course, 250);
    assert!(
        drive.state.speed_mps < 0.05,
        "{} m/s",
        drive.state.speed_mps
    );
    assert!(
        (1.0..12.0).contains(&drive.clearance_m),
        "{} m before it",
        drive.clearance_m
    );
}

/// The car stands beside a standing one; another comes from the side. The ranges
/// are those of a body that crosses the road ahead.
#[test]
fn lets_a_crossing_body_pass() {
    let road = Course::new(&[Road {
        length_m: 200.0,
        curvature_per_m: 0.0,
    }]);
    let vehicle = Vehicle::default();
    let mut planner = mpc();
    let mut plan = Plan::default();
    let start = road.pose_at(5.0);
    let mut state = State {
        position: start.translation.vector.into(),
        heading_rad: 0.0,
        speed_mps: 8.0,
    };
    let mut nearest_m = f64::INFINITY;
    for tick in 0..80 {
        let crossing_y_m = -30.0 + 7.0 * tick as f64 * STEP_S;
        let mut course = road.clone();
        course.put(40.0, 0.0, CAR);
        course.obstacles[0].world_from_obstacle =
            pose(40.0, crossing_y_m, std::f64::consts::FRAC_PI_2);
        nearest_m = nearest_m.min(course.clearance_m(&vehicle, &state.pose()));
        planner.plan(&at_tick(course.observe(&state, tick), tick), &mut plan);
        let action = plan.action_at(0).expect("an action");
        state = step(&vehicle, &state, action.control(&vehicle), STEP_S);
    }
    assert!(nearest_m > 0.3, "{nearest_m} m");
    assert!(state.position.x > 40.0, "drives on: {} m", state.position.x);
}

/// The plan is the same whether the car stands with its brake on or off: the pedal of
/// another driver is no reason to stay.
#[test]
fn drives_off_from_rest_however_the_brake_was_set() {
    let road = Course::new(&[Road {
        length_m: 200.0,
        curvature_per_m: 0.0,
    }]);
    let start = road.pose_at(5.0);
    let state = State {
        position: start.translation.vector.into(),
        heading_rad: 0.0,
        speed_mps: 0.0,
    };
    let first = |pedal: f64| {
        let mut observation = at_tick(road.observe(&state, 0), 0);
        observation.ego.pedal = pedal;
        let mut plan = Plan::default();
        mpc().plan(&observation, &mut plan);
        plan.action_at(0).expect("an action").pedal
    };
    let free = first(0.0);
    assert!(free > 0.2, "{free}");
    for held in [-1.0, -0.5, -0.1] {
        assert_eq!(first(held), free, "brake {held}");
    }
}

/// Whatever is seen, however the car jumps about: an answer that is in range.
#[test]
fn always_has_an_answer() {
    let mut planner = mpc();
    let mut plan = Plan::default();
    let mut dice = Dice::new(7);
    let mut solved = 0;
    for tick in 0..600 {
        let mut observation = at_tick(random_scene(tick), tick);
        let ego = &mut observation.ego;
        ego.speed_mps = dice.between(-1.0, 22.0);
        ego.yaw_rate_radps = dice.between(-2.0, 2.0);
        ego.steer = dice.between(-1.0, 1.0);
        ego.pedal = dice.between(-1.0, 1.0);
        ego.x_world_m = dice.between(-1e4, 1e4);
        observation.road.heading_rad = dice.between(-3.0, 3.0);
        observation.road.left_m = dice.between(-3.0, 12.0);
        observation.road.right_m = dice.between(-3.0, 12.0);
        if dice.below(4) == 0 {
            // Something all around.
            observation.ranges_m.fill(dice.between(0.5, 20.0) as f32);
        }
        if dice.below(50) == 0 {
            observation.beam_count = 0;
        }
        planner.plan(&observation, &mut plan);
        assert_eq!(plan.check(), Ok(()), "tick {tick}");
        assert!(plan.action_count > 0, "tick {tick}");
        solved += u64::from(planner.effort().is_solved);
    }
    assert_eq!(solved, 600, "an infeasible problem");
}

#[test]
fn a_solver_that_gives_up_leaves_the_brake() {
    let mut config = config();
    config.mpc.iterations = 1;
    let mut planner = Mpc::new(&config);
    let mut plan = Plan::default();
    for tick in 0..3 {
        planner.plan(&at_tick(random_scene(0), tick), &mut plan);
        assert!(!planner.effort().is_solved);
        assert_eq!(plan.outcome(), PlanOutcome::Blocked);
        assert_eq!(plan.action_at(0).map(|action| action.pedal), Some(-1.0));
    }
}

#[test]
fn the_same_observations_give_the_same_plans_and_an_episode_forgets() {
    let scenes: Vec<Observation> = (0..40)
        .map(|tick| at_tick(random_scene(tick / 20), tick))
        .collect();
    let plans = |planner: &mut Planner| -> Vec<Plan> {
        let mut out = Plan::default();
        let plan = |scene| {
            planner.plan(scene, &mut out);
            out
        };
        scenes.iter().map(plan).collect()
    };
    let mut planner = Planner::new(&config()).unwrap();
    let first = plans(&mut planner);
    planner.forget();
    let again = plans(&mut planner);
    let fresh = plans(&mut Planner::new(&config()).unwrap());
    for (index, plan) in first.iter().enumerate() {
        for other in [&again[index], &fresh[index]] {
            assert_eq!(plan.actions(), other.actions(), "plan {index}");
            assert_eq!(plan.waypoints(), other.waypoints(), "plan {index}");
        }
    }
}
