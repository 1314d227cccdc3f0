//! What becomes of a decision that is over its deadline.

use controller::{Controller, Inputs, Intent, PolicySlot};
use shm_config::Instant;
use shm_config::config::{Config, GateMode, Late};
use shm_config::message::{Command, Driver, Reason};

use crate::road::{observation, plan};

const NOW: Instant = Instant(100_000_000_000);

/// The command as decided, the one after the deadline, and whether it goes out.
fn answer(policy: Late) -> (Command, Command, bool) {
    let mut config = Config::default();
    config.gate.mode = GateMode::Expert;
    config.deadlines.controller = policy;
    let mut controller = Controller::new(config, PolicySlot::new(None));
    let inputs = Inputs {
        observation: observation(NOW).into(),
        plan: plan(NOW, 0.3).into(),
        ..Inputs::default()
    };
    let decided = controller.tick(&inputs, 7, NOW, Intent::Drive).command;
    assert_eq!(decided.driver(), Driver::Expert);
    let goes_out = controller.answer_late();
    (decided, controller.step().command, goes_out)
}

#[test]
fn counted_it_goes_out_as_it_is() {
    let (decided, answered, goes_out) = answer(Late::Count);
    assert_eq!(decided, answered);
    assert!(goes_out);
}

#[test]
fn skipped_it_stays_at_home_and_the_step_says_so() {
    let (decided, answered, goes_out) = answer(Late::Skip);
    assert!(!goes_out);
    assert_eq!(answered.reason(), Some(Reason::Late));
    assert_eq!(answered.driver(), decided.driver());
}

#[test]
fn braked_it_brakes_along_the_line_that_was_decided() {
    let (decided, answered, goes_out) = answer(Late::Brake);
    assert!(goes_out);
    assert_eq!(
        (answered.driver(), answered.reason()),
        (Driver::Brake, Some(Reason::Late))
    );
    assert_eq!((answered.steer, answered.pedal), (decided.steer, -1.0));
}
