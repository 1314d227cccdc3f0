//! A policy that is told how the bodies around the car move.

use controller::{Controller, Inputs, Intent, Policy, PolicySlot, Recomputer};
use shm_config::Instant;
use shm_config::config::{Config, GateMode};
use shm_config::message::{
    FEATURES, INPUTS_WITH_MOTION, MOTION_AT_REST, MOTION_FEATURES, Observation, Step,
};
use vehicle::Action;

use crate::road;

const PERIOD_NS: u64 = 100_000_000;

/// Steers by the velocity to the left that it is told of what is ahead.
struct Dodging;

impl Policy for Dodging {
    fn infer(&mut self, features: &[f32]) -> Option<Action> {
        assert_eq!(features.len(), INPUTS_WITH_MOTION);
        Some(Action {
            steer: f64::from(features[FEATURES] - MOTION_AT_REST),
            pedal: 0.25,
        })
    }
    fn takes_motion(&self) -> bool {
        true
    }
    fn version(&self) -> u64 {
        3
    }
    fn hash(&self) -> u64 {
        0xD0D6E
    }
}

fn config() -> Config {
    let mut config = Config::default();
    config.gate.mode = GateMode::Policy;
    config
}

/// Something ahead drives away at 8 m/s; the car itself stands.
fn away(tick: u64) -> Observation {
    let mut observation = road::observation(Instant(tick * PERIOD_NS));
    observation.header.tick = tick;
    observation.ego.speed_mps = 0.0;
    let ahead_m = 12.0 + 0.8 * tick as f32;
    for beam in (0..3).chain(238..240) {
        observation.ranges_m[beam] = ahead_m;
    }
    observation
}

fn steps(policy: Option<Box<dyn Policy>>, ticks: u64) -> Vec<Step> {
    let mut controller = Controller::new(config(), PolicySlot::new(policy));
    let mut inputs = Inputs::default();
    let mut step = |tick: u64| {
        let observation = away(tick);
        let now = observation.header.taken();
        inputs.observation.keep(&observation);
        *controller.tick(&inputs, tick, now, Intent::Drive)
    };
    (0..ticks).map(&mut step).collect()
}

#[test]
fn it_is_told_and_the_step_holds_what_it_was_told() {
    let steps = steps(Some(Box::new(Dodging)), 20);
    let [first, .., last] = &steps[..] else {
        panic!("20 steps");
    };
    assert_eq!(first.motion, [MOTION_AT_REST; MOTION_FEATURES], "one scan");
    let velocity_mps = (last.motion[0] - MOTION_AT_REST) * 40.0;
    assert!((velocity_mps - 8.0).abs() < 1.0, "{velocity_mps} m/s");
    let steer = f64::from(last.motion[0] - MOTION_AT_REST);
    assert_eq!(
        last.policy.steer, steer,
        "its proposal follows from the step"
    );
}

#[test]
fn nothing_is_followed_for_a_policy_that_does_not_take_it() {
    let policy = road::Fixed(Action {
        steer: 0.0,
        pedal: 0.2,
    });
    for policy in [None, Some(Box::new(policy) as Box<dyn Policy>)] {
        for step in steps(policy, 20) {
            assert_eq!(step.motion, [MOTION_AT_REST; MOTION_FEATURES]);
        }
    }
}

#[test]
fn each_tick_is_recomputed_from_its_step_alone() {
    let mut recomputer = Recomputer::with_policy(&config(), Box::new(Dodging));
    for step in steps(Some(Box::new(Dodging)), 20).iter().rev() {
        assert_eq!(recomputer.first_difference(step), None);
    }
}
