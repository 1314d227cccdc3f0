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
