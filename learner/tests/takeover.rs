//! Tests that a person's takeover is labelled and imitated, and that a person who lets
//! the policy drive gives no label.

use learner::assembler::{Assembler, Counts, Labelling, expert_command};
use learner::replay::Transition;
use shm_config::config::GateMode;
use shm_config::message::{Driver, Preference, Proposal, Reason, Step};
use vehicle::Action;

const PERSON: Action = Action {
    steer: -0.5,
    pedal: 0.25,
};

/// The step of one tick; the safety check would have vetoed the expert's action, which
/// may be the person's.
fn step(tick: u64, driver: Driver, reason: Reason) -> Step {
    let mut step = Step::default();
    step.header.sequence = tick;
    step.header.tick = tick;
    step.header.taken_ns = tick * 100_000_000;
    step.observation_age_ns = 0;
    let observation = &mut step.observation;
    (observation.header.tick, observation.beam_count) = (tick, 240);
    observation.header.taken_ns = step.header.taken_ns;
    step.expert = Proposal::new(Some(PERSON));
    step.expert_assessment.veto = 1;
    step.policy = Proposal::new(Some(Action::BRAKE));
    (step.command.steer, step.command.pedal) = (PERSON.steer, PERSON.pedal);
    (step.command.driver, step.command.reason) = (driver.code(), reason.code());
    step
}

#[test]
fn a_takeover_is_labelled_and_imitated_and_the_rest_is_not() {
    for mode in [GateMode::Human, GateMode::Takeover] {
        assert_takeovers_teach(mode);
    }
}

fn assert_takeovers_teach(mode: GateMode) {
    let labelling = Labelling {
        mode,
        wait_ns: 0,
        truncated_at: None,
    };
    let rows = [
        (Driver::Policy, Reason::Configured, Preference::Abstain),
        (Driver::Expert, Reason::Takeover, Preference::Expert),
        (Driver::Expert, Reason::Vetoed, Preference::Expert),
        (Driver::Expert, Reason::Unloaded, Preference::Abstain),
        (Driver::Expert, Reason::Faulty, Preference::Abstain),
        (Driver::Policy, Reason::Configured, Preference::Abstain),
    ];
    let mut assembler = Assembler::new(labelling, Counts::default());
    let mut made: Vec<Transition> = Vec::new();
    for (tick, (driver, reason, _)) in (1..).zip(rows) {
        assembler.push(&step(tick, driver, reason), |one| made.push(one));
    }
    assembler.finish(|one| made.push(one));
    let labels: Vec<Preference> = made.iter().map(|one| one.label).collect();
    assert_eq!(labels, rows.map(|(_, _, label)| label));
    let person = [PERSON.steer as f32, PERSON.pedal as f32];
    assert_eq!(made[1].expert, person, "a person is not vetoed");
    assert_eq!(made[1].applied, person);
    assert_ne!(made[2].expert, person, "the planned expert is");
    let counts = assembler.counts();
    assert_eq!((counts.expert, counts.interventions), (2, 4));
}

#[test]
fn only_a_persons_command_is_not_braked_by_the_safety_check() {
    let taken_over = step(1, Driver::Expert, Reason::Takeover);
    assert_eq!(expert_command(&taken_over), PERSON);
    let planned = step(1, Driver::Expert, Reason::Configured);
    assert_eq!(expert_command(&planned).pedal, Action::BRAKE.pedal);
}
