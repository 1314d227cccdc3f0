//! Takeovers: which driver drives during one, and without one.

use controller::{Controller, Inputs, Intent, Policy, PolicySlot};
use shm_config::Instant;
use shm_config::config::{Config, GateMode};
use shm_config::message::{Driver, Reason, Step, Takeover};
use vehicle::Action;

use crate::road::{Fixed, observation, plan, wall};

const NOW: Instant = Instant(100_000_000_000);
const TICK_NS: u64 = 100_000_000;

const POLICY: Action = Action {
    steer: 0.1,
    pedal: -0.2,
};
const PERSON: Action = Action {
    steer: -0.4,
    pedal: 0.3,
};

fn takeover(active: u32, taken: Instant) -> Takeover {
    let mut takeover = Takeover {
        steer: PERSON.steer,
        pedal: PERSON.pedal,
        active,
        ..Takeover::default()
    };
    takeover.header.taken_ns = taken.0;
    takeover
}

struct Seat {
    controller: Controller,
    now: Instant,
}

impl Seat {
    fn new(mode: GateMode, has_policy: bool) -> Self {
        let mut config = Config::default();
        config.gate.mode = mode;
        let policy = has_policy.then(|| Box::new(Fixed(POLICY)) as Box<dyn Policy>);
        Self {
            controller: Controller::new(config, PolicySlot::new(policy)),
            now: NOW,
        }
    }

    /// One tick later, with everything fresh, and what the person said of late.
    fn tick(&mut self, takeover: Option<Takeover>) -> Step {
        let inputs = Inputs {
            observation: observation(self.now).into(),
            plan: plan(self.now, 0.0).into(),
            takeover: takeover.into(),
            ..Inputs::default()
        };
        self.tick_on(&inputs, Intent::Drive)
    }

    fn tick_on(&mut self, inputs: &Inputs, intent: Intent) -> Step {
        let step = *self.controller.tick(inputs, 5, self.now, intent);
        self.now = self.now.after_ns(TICK_NS);
        step
    }
}

#[track_caller]
fn assert_drove(step: &Step, driver: Driver, reason: Reason) {
    assert_eq!((step.driver(), step.reason()), (driver, Some(reason)));
}

#[test]
fn the_policy_drives_until_a_person_takes_over_and_again_when_they_give_back() {
    let mut seat = Seat::new(GateMode::Human, true);
    assert_drove(&seat.tick(None), Driver::Policy, Reason::Configured);
    let idle = takeover(0, seat.now);
    assert_drove(&seat.tick(Some(idle)), Driver::Policy, Reason::Configured);

    let step = seat.tick(Some(takeover(1, seat.now)));
    assert_drove(&step, Driver::Expert, Reason::Takeover);
    assert_eq!(step.command.action(), PERSON);
    assert_eq!(step.expert.action(), Some(PERSON), "what is imitated");
    assert_eq!(step.policy.action(), Some(POLICY), "asked all the same");
    assert_eq!(step.takeover.action(), Some(PERSON));

    let step = seat.tick(Some(takeover(0, seat.now)));
    assert_drove(&step, Driver::Policy, Reason::Configured);
    assert_ne!(step.expert.action(), Some(PERSON), "the plan's again");
}

#[test]
fn an_old_word_is_no_takeover() {
    let mut seat = Seat::new(GateMode::Human, true);
    let said = NOW;
    assert_drove(
        &seat.tick(Some(takeover(1, said))),
        Driver::Expert,
        Reason::Takeover,
    );
    // 300 ms: the ticks at 100, 200 and 300 ms still go by it, that at 400 does not.
    for _ in 0..3 {
        assert_drove(&seat.tick(None), Driver::Expert, Reason::Takeover);
    }
    assert_drove(&seat.tick(None), Driver::Policy, Reason::Configured);
    // Nor does it help to say the old word again, and it is counted.
    let step = seat.tick(Some(takeover(1, said)));
    assert_drove(&step, Driver::Policy, Reason::Configured);
    assert_eq!(step.refused, 1);
}

#[test]
fn a_word_that_makes_no_sense_is_refused_and_the_last_good_one_stays() {
    let spoils: [fn(&mut Takeover); 4] = [
        |word| word.steer = f64::NAN,
        |word| word.pedal = f64::NEG_INFINITY,
        |word| word.steer = 1.5,
        |word| word.active = 2,
    ];
    for (case, spoil) in spoils.iter().enumerate() {
        let mut seat = Seat::new(GateMode::Human, true);
        let mut bad = takeover(1, seat.now);
        spoil(&mut bad);
        let step = seat.tick(Some(bad));
        assert_drove(&step, Driver::Policy, Reason::Configured);
        assert_eq!(step.refused, 1, "case {case}");
        seat.tick(Some(takeover(1, seat.now)));
        bad.header.taken_ns = seat.now.0;
        let step = seat.tick(Some(bad));
        assert_drove(&step, Driver::Expert, Reason::Takeover);
        assert_eq!(step.command.action(), PERSON, "case {case}");
    }
}

#[test]
fn without_a_policy_the_planned_expert_drives_between_takeovers() {
    let mut seat = Seat::new(GateMode::Human, false);
    assert_drove(&seat.tick(None), Driver::Expert, Reason::Unloaded);
    let step = seat.tick(Some(takeover(1, seat.now)));
    assert_drove(&step, Driver::Expert, Reason::Takeover);
    assert_drove(
        &seat.tick(Some(takeover(0, seat.now))),
        Driver::Expert,
        Reason::Unloaded,
    );
}

#[test]
fn the_judge_vetoes_the_policy_and_not_the_person_but_judges_both() {
    let mut seat = Seat::new(GateMode::Human, true);
    let mut inputs = Inputs {
        observation: wall(seat.now).into(),
        plan: plan(seat.now, 0.0).into(),
        ..Inputs::default()
    };
    let step = seat.tick_on(&inputs, Intent::Drive);
    assert!(step.policy_assessment.is_vetoed());
    assert_ne!(step.driver(), Driver::Policy);

    inputs.observation = wall(seat.now).into();
    inputs.takeover = takeover(1, seat.now).into();
    let step = seat.tick_on(&inputs, Intent::Drive);
    assert!(step.expert_assessment.is_vetoed(), "it is recorded");
    assert_drove(&step, Driver::Expert, Reason::Takeover);
    assert_eq!(step.command.action(), PERSON);
}

#[test]
fn a_person_needs_no_plan_but_does_not_drive_blind_nor_past_the_end() {
    let mut seat = Seat::new(GateMode::Human, true);
    let unplanned = Inputs {
        observation: observation(seat.now).into(),
        takeover: takeover(1, seat.now).into(),
        ..Inputs::default()
    };
    let step = seat.tick_on(&unplanned, Intent::Drive);
    assert_drove(&step, Driver::Expert, Reason::Takeover);

    let ending = Inputs {
        observation: observation(seat.now).into(),
        takeover: takeover(1, seat.now).into(),
        ..Inputs::default()
    };
    let step = seat.tick_on(&ending, Intent::Stop);
    assert_drove(&step, Driver::Brake, Reason::Stopping);
    assert_eq!(step.command.steer, PERSON.steer, "the person still steers");

    seat.now = seat.now.after_ns(10 * TICK_NS);
    let blind = Inputs {
        takeover: takeover(1, seat.now).into(),
        ..Inputs::default()
    };
    let step = seat.tick_on(&blind, Intent::Drive);
    assert_drove(&step, Driver::Brake, Reason::Blind);
}

#[test]
fn a_takeover_has_no_effect_where_no_person_is_configured() {
    for mode in [GateMode::Rules, GateMode::Expert, GateMode::Policy] {
        let mut seat = Seat::new(mode, true);
        let step = seat.tick(Some(takeover(1, seat.now)));
        assert_ne!(step.reason(), Some(Reason::Takeover), "{mode:?}");
        assert_ne!(step.expert.action(), Some(PERSON), "{mode:?}");
    }
}

#[test]
fn the_expert_takes_over_in_exactly_the_ticks_in_which_the_policy_is_far_off() {
    let expert = Seat::new(GateMode::Takeover, true)
        .tick(None)
        .expert
        .action();
    let expert = expert.expect("the expert proposes");
    let at = |steer: f64, pedal: f64| Action {
        steer: expert.steer + steer,
        pedal: expert.pedal - pedal,
    };
    let limits = Config::default().gate;
    let (steer, pedal) = (limits.takeover_steer, limits.takeover_pedal);
    let rows = [
        (at(0.0, 0.0), Driver::Policy, Reason::Configured),
        (
            at(0.9 * steer, 0.9 * pedal),
            Driver::Policy,
            Reason::Configured,
        ),
        (at(1.1 * steer, 0.0), Driver::Expert, Reason::Takeover),
        (at(-1.1 * steer, 0.0), Driver::Expert, Reason::Takeover),
        (at(0.0, 1.1 * pedal), Driver::Expert, Reason::Takeover),
    ];
    for (policy, driver, reason) in rows {
        let mut config = Config::default();
        config.gate.mode = GateMode::Takeover;
        let slot = PolicySlot::new(Some(Box::new(Fixed(policy)) as Box<dyn Policy>));
        let mut seat = Seat {
            controller: Controller::new(config, slot),
            now: NOW,
        };
        let step = seat.tick(None);
        assert_drove(&step, driver, reason);
        assert_eq!(step.takeover_used, 0, "no person did");
        let wanted = match driver {
            Driver::Expert => expert,
            _ => policy,
        };
        let command = Action {
            steer: step.command.steer,
            pedal: step.command.pedal,
        };
        assert_eq!(command, wanted.clamped(), "nothing is eased");
    }
}

#[test]
fn the_way_back_from_a_takeover_by_distance_is_not_eased() {
    let straight = Seat::new(GateMode::Expert, false)
        .tick(None)
        .expert
        .action();
    let straight = straight.expect("the expert proposes");
    let mut config = Config::default();
    config.gate.mode = GateMode::Takeover;
    let slot = PolicySlot::new(Some(Box::new(Fixed(straight)) as Box<dyn Policy>));
    let mut seat = Seat {
        controller: Controller::new(config, slot),
        now: NOW,
    };
    let mut tick = |left_m: f64| {
        let inputs = Inputs {
            observation: observation(seat.now).into(),
            plan: plan(seat.now, left_m).into(),
            ..Inputs::default()
        };
        seat.tick_on(&inputs, Intent::Drive)
    };
    let aside = tick(1.0);
    assert_drove(&aside, Driver::Expert, Reason::Takeover);
    let limit = Config::default().gate.takeover_steer;
    assert!((aside.command.steer - straight.steer).abs() > limit);
    // The expert's control has a memory: it may be far off for another tick.
    let back = (0..5).map(|_| tick(0.0));
    let mut driven = back.filter(|step| step.driver() == Driver::Policy);
    let first = driven.next().expect("the policy drives again");
    assert_eq!(first.command.action(), straight.clamped());
}

#[test]
fn the_expert_drives_without_a_takeover_where_the_policy_may_not_drive() {
    let mut seat = Seat::new(GateMode::Takeover, false);
    assert_drove(&seat.tick(None), Driver::Expert, Reason::Unloaded);
    // The keys of a person have no effect in this mode.
    let active = takeover(1, seat.now);
    assert_drove(&seat.tick(Some(active)), Driver::Expert, Reason::Unloaded);
}
