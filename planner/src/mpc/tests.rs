//! What is answered when the solver is not.

use super::*;
use shm_config::config::Clock;

fn config() -> Config {
    let mut config = Config::default();
    config.run.clock = Clock::Lockstep;
    config
}

/// A straight road of three lanes, nothing on it.
fn free_road(tick: u64) -> Observation {
    free_road_at(tick, tick * 100_000_000)
}

fn free_road_at(tick: u64, taken_ns: u64) -> Observation {
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.ranges_m[..240].fill(50.0);
    observation.header.tick = tick;
    observation.header.taken_ns = taken_ns;
    (observation.road.left_m, observation.road.right_m) = (5.25, 5.25);
    observation.checkpoints[0].x_body_m = 60.0;
    observation.checkpoints[1].x_body_m = 60.0;
    observation
}

#[test]
fn the_last_answer_is_followed_to_its_end_and_then_the_brake() {
    let mut mpc = Mpc::new(&config());
    let mut plan = Plan::default();
    mpc.plan(&free_road(0), &mut plan);
    assert!(mpc.effort().is_solved);
    let good: Vec<PlannedAction> = plan.actions().to_vec();
    assert!(good[0].pedal > 0.0, "it sets off");
    let hopeless = Settings {
        iterations: 1,
        ..Settings::default()
    };
    mpc.problem = Problem::new(&hopeless, f64::INFINITY);
    for tick in 1..good.len() {
        mpc.plan(&free_road(tick as u64), &mut plan);
        assert!(!mpc.effort().is_solved);
        assert_eq!(plan.actions(), &good[tick..], "tick {tick}");
    }
    for tick in good.len()..good.len() + 3 {
        mpc.plan(&free_road(tick as u64), &mut plan);
        let action = plan.action_at(0).map(|action| action.pedal);
        assert_eq!(action, Some(-1.0), "tick {tick}");
        assert_eq!(plan.outcome(), PlanOutcome::Blocked);
    }
}

/// At the given planner's rate, with a solver that fails after the first plan.
#[test]
fn the_last_answer_is_followed_by_the_time_that_has_passed() {
    for (rate_hz, plans) in [(2.5, 8), (5.0, 14), (20.0, 55), (30.0, 80)] {
        let mut mpc = Mpc::new(&config());
        let mut plan = Plan::default();
        mpc.plan(&free_road(0), &mut plan);
        let good = plan;
        let hopeless = Settings {
            iterations: 1,
            ..Settings::default()
        };
        mpc.problem = Problem::new(&hopeless, f64::INFINITY);
        for tick in 1..=plans {
            let taken_ns = (tick as f64 * 1e9 / rate_hz) as u64;
            mpc.plan(&free_road_at(tick, taken_ns), &mut plan);
            assert!(!mpc.effort().is_solved);
            // Where the first plan would be read had no other followed.
            match good.action_at(taken_ns) {
                Some(action) => assert_eq!(
                    plan.action_at(0),
                    Some(action),
                    "{rate_hz} Hz, {taken_ns} ns"
                ),
                None => assert_eq!(plan.outcome(), PlanOutcome::Blocked, "{rate_hz} Hz"),
            }
        }
    }
}

#[test]
fn an_answer_of_another_episode_or_long_ago_is_not_followed() {
    for (episode, tick) in [(1, 1), (0, 7), (0, 0)] {
        let mut mpc = Mpc::new(&config());
        let mut plan = Plan::default();
        mpc.plan(&free_road(0), &mut plan);
        let hopeless = Settings {
            iterations: 1,
            ..Settings::default()
        };
        mpc.problem = Problem::new(&hopeless, f64::INFINITY);
        let mut observation = free_road(tick);
        observation.header.episode = episode;
        mpc.plan(&observation, &mut plan);
        assert_eq!(plan.outcome(), PlanOutcome::Blocked, "{episode} {tick}");
    }
}

/// What a scan sees of bodies of this size, m, on both sides of the road's middle, 13 m ahead
/// at tick 0.
fn between(tick: u64, size_m: (f64, f64)) -> Observation {
    let mut observation = free_road(tick);
    observation.ego.speed_mps = 6.0;
    // It drives on by what it has measured of itself.
    observation.ego.x_world_m = 0.6 * tick as f64;
    let body = vehicle::Footprint {
        length_m: size_m.0,
        width_m: size_m.1,
    };
    let ahead_m = 13.0 - observation.ego.x_world_m;
    for (beam, range_m) in observation.ranges_m[..240].iter_mut().enumerate() {
        let (sin, cos) = (beam as f64 * 1.5_f64.to_radians()).sin_cos();
        let hits = |away_m: f64| {
            [-3.2, 3.2].iter().any(|left_m| {
                let at = Point::new(cos * away_m - ahead_m, sin * away_m - left_m);
                body.distance_m(at) <= 0.0
            })
        };
        let hit = (1..500)
            .map(|step| f64::from(step) * 0.1)
            .find(|&away_m| hits(away_m));
        *range_m = hit.unwrap_or(50.0) as f32;
    }
    observation
}

/// Slowest speed that is planned, m/s.
fn slowest_mps(size_m: (f64, f64), is_wary: bool) -> f64 {
    let mut config = config();
    config.mpc.wary = is_wary;
    let (mut mpc, mut plan) = (Mpc::new(&config), Plan::default());
    for tick in 0..5 {
        mpc.plan(&between(tick, size_m), &mut plan);
    }
    let waypoints = plan.waypoints().iter();
    waypoints
        .map(|waypoint| waypoint.speed_mps)
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn it_passes_slowly_between_cars_that_may_pull_out() {
    let cars_mps = slowest_mps((4.6, 1.85), true);
    assert!(
        cars_mps < speed::PASS_MPS + 1.0,
        "{cars_mps} m/s between cars"
    );
    let cones_mps = slowest_mps((0.4, 0.4), true);
    assert!(cones_mps > 5.0, "{cones_mps} m/s between cones");
    let unwary_mps = slowest_mps((4.6, 1.85), false);
    assert!(unwary_mps > 5.0, "{unwary_mps} m/s, not wary");
}
