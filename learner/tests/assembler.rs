//! Steps become transitions; every one of them is accounted for.

mod steps;

use learner::assembler::{Assembler, Counts, Labelling};
use learner::replay::{Label, Then, Transition};
use shm_config::config::GateMode;
use shm_config::message::{Preference, Reason, Step};
use steps::{CONTROLLER, PERIOD_NS, WORLD, advised, of_episode, state, step, vetoed};

/// Answers are awaited for 3.5 s.
const WAIT: u64 = 35;

/// An assembler, what it was given and what it made of it.
struct Bench {
    assembler: Assembler,
    given: Vec<Step>,
    made: Vec<Transition>,
}

impl Bench {
    fn new(mode: GateMode) -> Bench {
        let labelling = Labelling {
            mode,
            wait_ns: WAIT * PERIOD_NS,
        };
        Bench {
            assembler: Assembler::new(labelling, Counts::default()),
            given: Vec::new(),
            made: Vec::new(),
        }
    }

    fn push(&mut self, step: Step) {
        let made = &mut self.made;
        self.assembler
            .push(&step, |transition| made.push(transition));
        self.given.push(step);
        self.assert_accounts();
    }

    fn finish(&mut self) {
        let made = &mut self.made;
        self.assembler.finish(|transition| made.push(transition));
        self.assert_accounts();
        assert_eq!(self.assembler.waiting(), 0);
    }

    fn counts(&self) -> Counts {
        self.assembler.counts()
    }

    fn assert_accounts(&self) {
        let counts = self.counts();
        assert_eq!(counts.steps, self.given.len() as u64);
        assert_eq!(counts.transitions(), self.made.len() as u64, "{counts:?}");
        assert_eq!(
            counts.steps,
            counts.transitions() + counts.unseen + self.assembler.waiting(),
            "after step {}: {counts:?}",
            self.given.len()
        );
    }

    /// What was made of the given step, by what was seen then.
    fn of(&self, index: usize) -> &Transition {
        let wanted = state(&self.given[index]);
        let mut found = self.made.iter().filter(|made| made.state == wanted);
        let first = found.next();
        assert!(found.next().is_none(), "step {index} was made twice");
        first.unwrap_or_else(|| panic!("nothing was made of step {index}"))
    }

    fn labels(&self) -> Vec<Label> {
        (0..self.given.len())
            .map(|index| self.of(index).label)
            .collect()
    }
}

#[test]
fn a_tick_leads_to_the_next() {
    let mut bench = Bench::new(GateMode::Expert);
    for tick in 0..4 {
        bench.push(step(tick));
    }
    bench.finish();
    for index in 0..3 {
        let made = bench.of(index);
        assert_eq!(made.then, Then::On, "step {index}");
        assert_eq!(made.next, state(&bench.given[index + 1]), "step {index}");
        assert_eq!(made.label, Label::Expert);
        let given = &bench.given[index];
        assert_eq!(
            made.applied,
            [given.command.steer as f32, given.command.pedal as f32]
        );
        assert_eq!(
            made.policy,
            [given.policy.steer as f32, given.policy.pedal as f32]
        );
        assert_eq!(
            made.expert,
            [given.expert.steer as f32, given.expert.pedal as f32]
        );
    }
    assert_eq!(bench.of(3).then, Then::Unknown, "the run ended");
    assert_eq!(bench.counts().cut, 1);
    assert_eq!(bench.counts().lost, 0);
}

#[test]
fn an_episode_ends_where_the_next_begins() {
    let mut bench = Bench::new(GateMode::Expert);
    bench.push(step(0));
    bench.push(step(1));
    bench.push(of_episode(step(2), 1));
    bench.push(of_episode(step(3), 1));
    bench.finish();
    let thens = [0, 1, 2, 3].map(|index| bench.of(index).then);
    assert_eq!(thens, [Then::On, Then::End, Then::On, Then::Unknown]);
    let last = bench.of(1);
    assert_eq!(last.next, last.state, "nothing followed");
}

#[test]
fn after_an_episode_that_was_missed_nobody_knows_what_followed() {
    let mut bench = Bench::new(GateMode::Expert);
    bench.push(step(0));
    bench.push(of_episode(step(1), 2));
    bench.finish();
    assert_eq!(bench.of(0).then, Then::Unknown);
}

#[test]
fn a_lost_step_is_counted_and_cuts() {
    let mut bench = Bench::new(GateMode::Expert);
    for tick in [0, 1, 4, 5] {
        bench.push(step(tick));
    }
    bench.finish();
    assert_eq!(bench.counts().lost, 2);
    let thens = [0, 1, 2, 3].map(|index| bench.of(index).then);
    assert_eq!(thens, [Then::On, Then::Unknown, Then::On, Then::Unknown]);
    assert_eq!(bench.of(1).next, bench.of(1).state);
    assert_eq!(bench.counts().cut, 2);
}

#[test]
fn steps_before_the_first_one_heard_are_lost() {
    let mut bench = Bench::new(GateMode::Expert);
    bench.push(step(7));
    assert_eq!(bench.counts().lost, 7);
    // A learner that goes on knows what it heard last.
    let mut again = Bench::new(GateMode::Expert);
    again.assembler.follows((CONTROLLER, 6));
    again.push(step(7));
    assert_eq!(again.counts().lost, 1);
}

#[test]
fn a_restarted_controller_cuts_and_its_unheard_steps_are_lost() {
    let mut bench = Bench::new(GateMode::Expert);
    bench.push(step(0));
    bench.push(step(1));
    for (tick, sequence) in [(2, 3), (3, 4)] {
        let mut step = step(tick);
        step.header.producer = CONTROLLER + 1;
        step.header.sequence = sequence;
        bench.push(step);
    }
    bench.finish();
    assert_eq!(bench.counts().lost, 2, "it had published two before");
    let thens = [0, 1, 2].map(|index| bench.of(index).then);
    assert_eq!(thens, [Then::On, Then::Unknown, Then::On]);
}

#[test]
fn the_observation_before_a_controllers_restart_makes_no_second_transition() {
    let mut bench = Bench::new(GateMode::Expert);
    bench.push(step(0));
    let mut old = step(1);
    old.header.producer = CONTROLLER + 1;
    old.header.sequence = 1;
    old.observation = step(0).observation;
    bench.push(old);
    bench.finish();
    assert_eq!(bench.counts().unseen, 1);
    assert_eq!(bench.made.len(), 1);
}

#[test]
fn no_state_leaks_from_one_world_into_its_successor() {
    let mut bench = Bench::new(GateMode::Rules);
    for tick in 0..4 {
        bench.push(advised(step(tick), (1, 0), Preference::Expert));
    }
    for tick in 4..9 {
        let mut step = advised(step(tick), (1, 0), Preference::Expert);
        step.observation.header.producer = WORLD + 1;
        bench.push(step);
    }
    bench.finish();
    assert_eq!(bench.of(3).then, Then::Unknown);
    assert_eq!(bench.of(3).next, bench.of(3).state);
    let labels = bench.labels();
    assert_eq!(labels[..4], [Label::Expert; 4]);
    assert_eq!(
        labels[4..],
        [Label::None; 5],
        "the question was about another world"
    );
}

#[test]
fn another_run_on_another_clock_inherits_nothing() {
    let mut bench = Bench::new(GateMode::Rules);
    for tick in 100..104 {
        // It counts from 1 like any run's.
        let mut step = step(tick);
        step.header.sequence -= 100;
        bench.push(step);
    }
    bench.push(advised(
        {
            let mut step = step(104);
            step.header.sequence -= 100;
            step
        },
        // An early question of this run: its window holds ticks 2 to 11.
        (1, 2),
        Preference::Expert,
    ));
    for tick in 0..12 {
        let mut step = step(tick);
        step.header.producer = CONTROLLER + 1;
        step.observation.header.producer = WORLD + 1;
        bench.push(step);
    }
    assert_eq!(
        bench.made[..5].len(),
        5,
        "nothing of the first run waits any longer"
    );
    bench.finish();
    assert_eq!(bench.of(4).then, Then::Unknown);
    assert_eq!(bench.labels(), [Label::None; 17]);
}

#[test]
fn weights_that_are_swapped_mid_episode_cut_nothing() {
    let mut bench = Bench::new(GateMode::Policy);
    for tick in 0..6 {
        let mut step = step(tick);
        step.weights_version = 1 + tick / 3;
        bench.push(step);
    }
    bench.finish();
    assert!((0..5).all(|index| bench.of(index).then == Then::On));
}

#[test]
fn a_veto_labels_at_once() {
    let mut bench = Bench::new(GateMode::Rules);
    bench.push(vetoed(step(0)));
    bench.push(step(1));
    assert_eq!(bench.made.len(), 1, "no answer is awaited");
    assert_eq!(bench.of(0).label, Label::Expert);
    let mut policy = Bench::new(GateMode::Policy);
    policy.push(step(0));
    policy.push(vetoed(step(1)));
    policy.finish();
    assert_eq!(policy.labels(), [Label::None, Label::Expert]);
}

#[test]
fn a_late_answer_labels_the_steps_of_its_window_and_no_other() {
    for (preference, label) in [
        (Preference::Expert, Label::Expert),
        (Preference::Policy, Label::Policy),
    ] {
        let mut bench = Bench::new(GateMode::Rules);
        for tick in 0..60 {
            let step = step(tick);
            bench.push(match tick < 13 {
                true => step,
                false => advised(step, (1, 5), preference),
            });
        }
        bench.finish();
        let labels = bench.labels();
        for (tick, &given) in labels.iter().enumerate() {
            let expected = match (5..15).contains(&tick) {
                true => label,
                false => Label::None,
            };
            assert_eq!(given, expected, "{preference:?}, tick {tick}");
        }
    }
}

#[test]
fn a_step_keeps_its_own_veto_inside_a_window_for_the_policy() {
    let mut bench = Bench::new(GateMode::Rules);
    bench.push(advised(step(0), (1, 0), Preference::Policy));
    bench.push(advised(vetoed(step(1)), (1, 0), Preference::Policy));
    bench.push(advised(step(2), (1, 0), Preference::Policy));
    bench.finish();
    assert_eq!(
        bench.labels(),
        [Label::Policy, Label::Expert, Label::Policy]
    );
}

#[test]
fn an_abstention_makes_no_label_and_nobody_waits_for_another() {
    let mut bench = Bench::new(GateMode::Rules);
    for tick in 0..5 {
        bench.push(advised(step(tick), (1, 0), Preference::Abstain));
    }
    assert_eq!(bench.made.len(), 4);
    bench.finish();
    assert_eq!(bench.labels(), [Label::None; 5]);
    assert_eq!(bench.counts().unlabelled, 5);
}

#[test]
fn an_answer_that_never_comes_is_awaited_for_a_limited_time() {
    let mut bench = Bench::new(GateMode::Rules);
    for tick in 0..=WAIT {
        bench.push(step(tick));
        assert_eq!(bench.made.len(), 0, "tick {tick}");
    }
    bench.push(step(WAIT + 1));
    assert_eq!(bench.made.len(), 1);
    assert_eq!(bench.of(0).label, Label::None);
    for tick in WAIT + 2..200 {
        bench.push(step(tick));
        assert!(bench.assembler.waiting() <= WAIT + 1, "tick {tick}");
    }
}

#[test]
fn a_window_ends_with_its_episode() {
    let mut bench = Bench::new(GateMode::Rules);
    for tick in 0..12 {
        let step = of_episode(step(tick), u32::from(tick >= 8));
        bench.push(advised(step, (1, 5), Preference::Expert));
    }
    bench.finish();
    let labels = bench.labels();
    assert_eq!(labels[..5], [Label::None; 5]);
    assert_eq!(labels[5..8], [Label::Expert; 3]);
    assert_eq!(labels[8..], [Label::None; 4]);
}

#[test]
fn an_observation_counts_once_however_long_it_stays_the_newest() {
    let mut bench = Bench::new(GateMode::Rules);
    for tick in 0..10 {
        let mut step = advised(step(tick), (1, 0), Preference::Expert);
        if (2..6).contains(&tick) {
            // The world is late: what was seen at tick 1 is the newest still.
            step.observation = self::step(1).observation;
        }
        bench.push(step);
    }
    bench.finish();
    assert_eq!(bench.counts().unseen, 4);
    assert_eq!(bench.made.len(), 6);
    assert_eq!(bench.counts().cut, 2, "tick 1 and the last");
    let labels: Vec<Label> = bench.made.iter().map(|made| made.label).collect();
    assert_eq!(labels, [Label::Expert; 6], "the question's episode went on");
}

#[test]
fn a_blind_step_is_no_transition() {
    let mut bench = Bench::new(GateMode::Expert);
    bench.push(step(0));
    let mut blind = step(1);
    blind.command.reason = Reason::Blind.code();
    bench.push(blind);
    let mut never = step(2);
    never.observation_age_ns = u64::MAX;
    bench.push(never);
    let mut beams = step(3);
    beams.observation.beam_count = 120;
    bench.push(beams);
    bench.push(step(4));
    bench.finish();
    assert_eq!(bench.counts().unseen, 3);
    assert_eq!(bench.of(0).then, Then::Unknown);
    assert_eq!(bench.made.len(), 2);
}
