//! The tick answers every input and says why.

use controller::{Controller, Inputs, Intent, Policy, PolicySlot};
use shm_config::Instant;
use shm_config::config::{Config, GateMode};
use shm_config::message::{
    Advice, Driver, Plan, PlanOutcome, Preference, Reason, Step, Verdict, Waypoint,
};
use vehicle::Action;

use crate::road::{self, Fixed, observation, wall};

const SECOND: u64 = 1_000_000_000;
const NOW: Instant = Instant(100 * SECOND);

/// A plan that turns left a little.
fn plan(now: Instant) -> Plan {
    road::plan(now, 0.3)
}

fn advice(preference: Preference, until: Instant) -> Advice {
    Advice {
        preference: preference.code(),
        answers: 1,
        question_taken_ns: NOW.0 - SECOND,
        holds_until_ns: until.0,
        ..Advice::default()
    }
}

fn inputs() -> Inputs {
    Inputs {
        observation: observation(NOW).into(),
        plan: plan(NOW).into(),
        ..Inputs::default()
    }
}

fn controller(mode: GateMode, policy: Option<Action>) -> Controller {
    let mut config = Config::default();
    config.gate.mode = mode;
    let policy = policy.map(|action| Box::new(Fixed(action)) as Box<dyn Policy>);
    Controller::new(config, PolicySlot::new(policy))
}

fn drive(controller: &mut Controller, inputs: &Inputs) -> Step {
    *controller.tick(inputs, 5, NOW, Intent::Drive)
}

const AHEAD: Action = Action {
    steer: 0.0,
    pedal: 0.0,
};

#[test]
fn without_a_policy_the_expert_drives_and_the_step_says_so() {
    let step = drive(&mut controller(GateMode::Rules, None), &inputs());
    assert_eq!(
        (step.driver(), step.reason()),
        (Driver::Expert, Some(Reason::Unloaded))
    );
    assert_eq!(step.policy_assessment.verdict(), Verdict::Absent);
    assert_eq!(step.weights_version, 0);
    // The nearest waypoint at 2 m or more is (3.0, 0.6): steer = 2 atan2(0.6, 3).
    let expected = 2.0 * 0.6f64.atan2(3.0);
    assert!((step.command.steer - expected).abs() < 1e-12);
    assert_eq!(
        step.command.pedal, 0.0,
        "at v_ref there is nothing to correct"
    );
}

#[test]
fn the_switch_law_follows_valid_advice_only() {
    let (held, gone) = (NOW.after_ns(SECOND), Instant(NOW.0 - 1));
    let rows = [
        (None, Driver::Expert, Reason::Unadvised),
        (
            Some(advice(Preference::Policy, held)),
            Driver::Policy,
            Reason::Advised,
        ),
        (
            Some(advice(Preference::Expert, held)),
            Driver::Expert,
            Reason::Advised,
        ),
        (
            Some(advice(Preference::Abstain, held)),
            Driver::Expert,
            Reason::Unadvised,
        ),
        (
            Some(advice(Preference::Policy, gone)),
            Driver::Expert,
            Reason::Expired,
        ),
        (
            Some(Advice {
                answers: 0,
                ..advice(Preference::Policy, held)
            }),
            Driver::Expert,
            Reason::Unadvised,
        ),
    ];
    for (advice, driver, reason) in rows {
        let inputs = Inputs {
            advice: advice.into(),
            ..inputs()
        };
        let step = drive(&mut controller(GateMode::Rules, Some(AHEAD)), &inputs);
        assert_eq!(
            (step.driver(), step.reason()),
            (driver, Some(reason)),
            "{advice:?}"
        );
        assert_eq!((step.weights_version, step.weights_hash), (7, 0xABCD));
    }
    let unknown = Advice {
        preference: 99,
        ..advice(Preference::Policy, held)
    };
    let mut controller = controller(GateMode::Rules, Some(AHEAD));
    let step = drive(
        &mut controller,
        &Inputs {
            advice: unknown.into(),
            ..inputs()
        },
    );
    assert_eq!(
        (step.driver(), step.reason()),
        (Driver::Expert, Some(Reason::Unadvised))
    );
    assert_eq!(step.refused, 1, "an unknown code is refused at the door");
}

#[test]
fn a_policy_that_is_not_finite_or_not_safe_does_not_drive() {
    let nan = Action {
        steer: f64::NAN,
        pedal: 0.0,
    };
    let step = drive(&mut controller(GateMode::Policy, Some(nan)), &inputs());
    assert_eq!(
        (step.driver(), step.reason()),
        (Driver::Expert, Some(Reason::Faulty))
    );

    // A wall of returns two metres before the bumper: the policy holds its speed.
    let inputs = Inputs {
        observation: wall(NOW).into(),
        ..inputs()
    };
    let step = drive(&mut controller(GateMode::Policy, Some(AHEAD)), &inputs);
    assert_eq!(step.policy_assessment.verdict(), Verdict::Hits);
    assert!(step.policy_assessment.is_vetoed());
    assert_ne!(step.driver(), Driver::Policy);
    let braking = Action {
        steer: 0.0,
        pedal: -1.0,
    };
    let step = drive(&mut controller(GateMode::Policy, Some(braking)), &inputs);
    assert_eq!(
        (step.driver(), step.reason()),
        (Driver::Policy, Some(Reason::Configured))
    );
}

#[test]
fn silence_means_stop() {
    let limit_ns = Config::default().limits.observation_age_ns();
    let mut controller = controller(GateMode::Expert, None);
    let first = drive(&mut controller, &inputs());
    assert_eq!(
        (first.driver(), first.reason()),
        (Driver::Expert, Some(Reason::Configured))
    );
    let at_limit = *controller.tick(&Inputs::default(), 6, NOW.after_ns(limit_ns), Intent::Drive);
    assert_eq!(at_limit.driver(), Driver::Expert);
    let past = *controller.tick(
        &Inputs::default(),
        7,
        NOW.after_ns(limit_ns + 1),
        Intent::Drive,
    );
    assert_eq!(
        (past.driver(), past.reason()),
        (Driver::Brake, Some(Reason::Blind))
    );
    assert_eq!(past.command.pedal, -1.0);
    assert_eq!(past.observation_age_ns, limit_ns + 1);
}

#[test]
fn no_plan_or_a_blocked_one_brakes() {
    let step = drive(
        &mut controller(GateMode::Expert, None),
        &Inputs {
            plan: None.into(),
            ..inputs()
        },
    );
    assert_eq!(
        (step.driver(), step.reason()),
        (Driver::Brake, Some(Reason::Unplanned))
    );
    let blocked = Plan {
        outcome: PlanOutcome::Blocked.code(),
        ..plan(NOW)
    };
    let step = drive(
        &mut controller(GateMode::Expert, None),
        &Inputs {
            plan: blocked.into(),
            ..inputs()
        },
    );
    assert_eq!(
        (step.driver(), step.reason()),
        (Driver::Brake, Some(Reason::Blocked))
    );
    let old_episode = Plan {
        header: shm_config::message::Header {
            episode: 9,
            ..plan(NOW).header
        },
        ..plan(NOW)
    };
    let step = drive(
        &mut controller(GateMode::Expert, None),
        &Inputs {
            plan: old_episode.into(),
            ..inputs()
        },
    );
    assert_eq!(
        step.reason(),
        Some(Reason::Unplanned),
        "another episode's plan is not followed"
    );
}

#[test]
fn bad_observations_are_refused_and_the_last_good_one_stays() {
    let mut nan = observation(NOW);
    nan.ranges_m[17] = f32::NAN;
    let mut over = observation(NOW);
    over.beam_count = 2049;
    let mut wild = observation(NOW);
    wild.ego.speed_mps = f64::INFINITY;
    let mut bend = observation(NOW);
    bend.checkpoints[1].bend = 42;
    let future = observation(NOW.after_ns(SECOND));
    let old = observation(Instant(NOW.0 - SECOND));
    for bad in [nan, over, wild, bend, future, old] {
        let mut controller = controller(GateMode::Expert, None);
        drive(&mut controller, &inputs());
        let step = drive(
            &mut controller,
            &Inputs {
                observation: bad.into(),
                ..inputs()
            },
        );
        assert_eq!(step.refused, 1);
        assert_eq!(step.observation, observation(NOW));
        assert_eq!(step.driver(), Driver::Expert);
    }
}

#[test]
fn a_stopping_run_brakes_along_the_experts_line() {
    let mut controller = controller(GateMode::Expert, None);
    let step = *controller.tick(&inputs(), 5, NOW, Intent::Stop);
    assert_eq!(
        (step.driver(), step.reason()),
        (Driver::Brake, Some(Reason::Stopping))
    );
    assert_eq!(step.command.pedal, -1.0);
    assert_eq!(step.command.steer, step.expert.steer);
}

#[test]
fn derivatives_do_not_kick_on_the_first_tick_or_a_new_goal() {
    let mut slow = observation(NOW);
    slow.ego.speed_mps = 0.0;
    let mut controller = controller(GateMode::Expert, None);
    let step = drive(
        &mut controller,
        &Inputs {
            observation: slow.into(),
            ..inputs()
        },
    );
    assert_eq!(step.command.pedal, 0.1 * 5.0, "K_p alone");

    // Same goal, 0.1 s later: the derivative of the speed error counts.
    let later = NOW.after_ns(SECOND / 10);
    let mut faster = observation(later);
    faster.ego.speed_mps = 0.2;
    let next = Inputs {
        observation: faster.into(),
        plan: plan(later).into(),
        ..Inputs::default()
    };
    let step = *controller.tick(&next, 6, later, Intent::Drive);
    let expected = 0.1 * 4.8 + 0.05 * (4.8 - 5.0) / 0.1;
    assert!((step.command.pedal - expected).abs() < 1e-9);

    // Another goal: no derivative.
    let latest = later.after_ns(SECOND / 10);
    let mut elsewhere = plan(latest);
    elsewhere.goal_x_body_m = 25.0;
    let mut fastest = observation(latest);
    fastest.ego.speed_mps = 0.4;
    let next = Inputs {
        observation: fastest.into(),
        plan: elsewhere.into(),
        ..Inputs::default()
    };
    let step = *controller.tick(&next, 7, latest, Intent::Drive);
    assert!((step.command.pedal - 0.1 * 4.6).abs() < 1e-12);
}

#[test]
fn an_older_plan_is_moved_into_the_body_frame_of_now() {
    let later = NOW.after_ns(SECOND / 10);
    let mut moved = observation(later);
    // The car has turned left by 0.2 rad on the spot since the plan was made.
    moved.ego.heading_world_rad = 0.2;
    let inputs = Inputs {
        observation: moved.into(),
        plan: plan(NOW).into(),
        ..Inputs::default()
    };
    let step = *controller(GateMode::Expert, None).tick(&inputs, 6, later, Intent::Drive);
    let expected = 2.0 * (0.6f64.atan2(3.0) - 0.2);
    assert!((step.expert.steer - expected).abs() < 1e-12);
    assert_eq!(step.plan_age_ns, SECOND / 10);
}

/// A plan from standing at the origin, looking along x, to a point 6 m ahead and
/// 2 m left; then the car is somewhere else and has turned.
#[test]
fn an_older_plan_is_moved_by_the_egos_motion_since_it_was_made() {
    let mut older = plan(Instant(NOW.0 - SECOND / 10));
    older.waypoint_count = 2;
    older.waypoints[1] = Waypoint {
        x_body_m: 6.0,
        y_body_m: 2.0,
        speed_mps: 5.0,
    };
    let mut moved = observation(NOW);
    (moved.ego.x_world_m, moved.ego.y_world_m) = (2.0, 1.0);
    moved.ego.heading_world_rad = 0.3;
    let config = Config::default();
    let mut controller = Controller::new(config.clone(), PolicySlot::new(None));
    let inputs = Inputs {
        observation: moved.into(),
        plan: older.into(),
        ..Inputs::default()
    };
    let step = *controller.tick(&inputs, 5, NOW, Intent::Drive);
    // From (2, 1) the waypoint is 4 m along x and 1 m along y of the world.
    let bearing_rad = 1.0_f64.atan2(4.0) - 0.3;
    let steer = config.controller.steer_kp * bearing_rad;
    let expert = step.expert.action().expect("a proposal");
    assert!(
        (expert.steer - steer).abs() < 1e-12,
        "{} instead of {steer}",
        expert.steer
    );
    assert_eq!(step.plan_age_ns, SECOND / 10);

    // Without a new plan the next tick moves the same one on.
    let later = NOW.after_ns(SECOND / 100);
    moved.header.taken_ns = later.0;
    (moved.ego.x_world_m, moved.ego.heading_world_rad) = (2.05, 0.29);
    let inputs = Inputs {
        observation: moved.into(),
        ..Inputs::default()
    };
    let step = controller.tick(&inputs, 6, later, Intent::Drive);
    let turned_rad = 1.0_f64.atan2(3.95) - 0.29;
    let rate_radps = (turned_rad - bearing_rad) / 0.01;
    let steer = config.controller.steer_kp * turned_rad + config.controller.steer_kd * rate_radps;
    let expert = step.expert.action().expect("a proposal");
    assert!((expert.steer - steer).abs() < 1e-9);
}

#[test]
fn actions_of_an_older_plan_are_taken_by_its_age() {
    let mut actions = plan(NOW);
    (actions.action_step_s, actions.action_count) = (0.1, 3);
    for (k, action) in actions.actions.iter_mut().take(3).enumerate() {
        action.steer = 0.1 * (k + 1) as f64;
    }
    let mut controller = Controller::new(Config::default(), PolicySlot::new(None));
    let mut given = Some(actions);
    for tick in 0..25_u64 {
        let now = NOW.after_ns(tick * SECOND / 100);
        let inputs = Inputs {
            observation: observation(now).into(),
            plan: given.take().into(),
            ..Inputs::default()
        };
        let step = controller.tick(&inputs, tick, now, Intent::Drive);
        let expected = 0.1 * (tick / 10 + 1) as f64;
        let steer = step.expert.action().map(|action| action.steer);
        assert_eq!(steer, Some(expected), "tick {tick}");
    }
}

#[test]
fn the_plans_age_limit_follows_a_slower_planner() {
    let mut config = Config::default();
    config.planner.rate_hz = 2.0;
    let late = NOW.after_ns(SECOND);
    for (config, driver) in [(config, Driver::Expert), (Config::default(), Driver::Brake)] {
        let mut controller = Controller::new(config, PolicySlot::new(None));
        controller.tick(&inputs(), 5, NOW, Intent::Drive);
        let next = Inputs {
            observation: observation(late).into(),
            ..Inputs::default()
        };
        let step = controller.tick(&next, 6, late, Intent::Drive);
        assert_eq!(step.driver(), driver);
    }
}
