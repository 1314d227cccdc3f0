//! Hand-overs: the command moves from one driver's to the other's.

use controller::{Choice, Transfer};
use shm_config::config::Controller;
use shm_config::message::{Driver, Reason};
use vehicle::Action;

const PERIOD_S: f64 = 0.1;

fn choice(driver: Driver, reason: Reason, steer: f64, pedal: f64) -> Choice {
    Choice {
        driver,
        reason,
        action: Action { steer, pedal },
    }
}

fn transfer() -> Transfer {
    let gains = Controller {
        handover_steer_per_s: 2.0,
        handover_pedal_per_s: 5.0,
        ..Controller::default()
    };
    Transfer::new(&gains, PERIOD_S)
}

#[test]
fn the_jump_at_a_hand_over_is_limited_and_then_the_driver_is_followed_freely() {
    let mut transfer = transfer();
    let expert = choice(Driver::Expert, Reason::Advised, 0.0, 0.0);
    let policy = choice(Driver::Policy, Reason::Advised, -0.5, 1.0);
    assert_eq!(transfer.ease(&expert, 0, |_| true), expert.action);
    let eased: Vec<Action> = (0..4)
        .map(|_| transfer.ease(&policy, 0, |_| true))
        .collect();
    let steers: Vec<f64> = eased.iter().map(|action| action.steer).collect();
    let pedals: Vec<f64> = eased.iter().map(|action| action.pedal).collect();
    let near = |got: &[f64], wanted: [f64; 4]| {
        let close = got.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(close, "{got:?} is not {wanted:?}");
    };
    near(&steers, [-0.2, -0.4, -0.5, -0.5]);
    near(&pedals, [0.5, 1.0, 1.0, 1.0]);
    let jump = choice(Driver::Policy, Reason::Advised, 1.0, -1.0);
    let after = transfer.ease(&jump, 0, |_| true);
    assert_eq!(after, jump.action, "a driver's own jumps are its own");
}

#[test]
fn danger_is_no_time_for_easing() {
    let policy = choice(Driver::Policy, Reason::Advised, 0.0, 0.5);
    for urgent in [
        choice(Driver::Expert, Reason::Vetoed, 1.0, -1.0),
        choice(Driver::Expert, Reason::Takeover, 1.0, -1.0),
        choice(Driver::Brake, Reason::Unsafe, 1.0, -1.0),
    ] {
        let mut transfer = transfer();
        transfer.ease(&policy, 0, |_| true);
        let action = transfer.ease(&urgent, 0, |_| true);
        assert_eq!(action, urgent.action, "{}", urgent.reason);
    }
    let mut transfer = transfer();
    transfer.ease(&policy, 0, |_| true);
    let expert = choice(Driver::Expert, Reason::Advised, 1.0, -1.0);
    let action = transfer.ease(&expert, 0, |_| false);
    assert_eq!(action, expert.action, "an eased command that is unsafe");
}

#[test]
fn a_new_episode_begins_without_the_last_ones_command() {
    let mut transfer = transfer();
    transfer.ease(
        &choice(Driver::Policy, Reason::Advised, 1.0, 1.0),
        0,
        |_| true,
    );
    let expert = choice(Driver::Expert, Reason::Unadvised, -1.0, -1.0);
    assert_eq!(transfer.ease(&expert, 1, |_| true), expert.action);
}
