//! Tests that steps become transitions and that each step is counted.

use learner::assembler::{Assembler, Counts, Labelling};
use learner::replay::{Then, Transition};
use shm_config::config::GateMode;
use shm_config::message::{Preference, Reason, Step};

use crate::steps::{CONTROLLER, PERIOD_NS, WORLD, advised, of_episode, state, step, vetoed};

#[test]
fn a_sequence_number_at_the_end_of_its_range_does_not_overflow() {
    let mut bench = Bench::new(GateMode::Expert);
    for number in 1..=3 {
        let mut step = step(number);
        step.header.sequence = u64::MAX - u64::from(number == 1);
        bench.push(step);
    }
    assert_eq!(bench.counts().lost, u64::MAX - 2);
}

/// Answers are awaited for 3.5 s.
const WAIT: u64 = 35;

/// An assembler with the steps it received and the transitions it made.
struct Bench {
    assembler: Assembler,
    given: Vec<Step>,
    made: Vec<Transition>,
}

impl Bench {
    fn new(mode: GateMode) -> Bench {
        Bench::truncated_at(mode, None)
    }

    fn truncated_at(mode: GateMode, truncated_at: Option<u64>) -> Bench {
        let labelling = Labelling {
            mode,
            wait_ns: WAIT * PERIOD_NS,
            truncated_at,
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

    /// The transition made from the step with this index, found by its state.
    fn of(&self, index: usize) -> &Transition {
        let wanted = state(&self.given[index]);
        let mut found = self.made.iter().filter(|made| made.state == wanted);
        let first = found.next();
        assert!(found.next().is_none(), "step {index} was made twice");
        first.unwrap_or_else(|| panic!("nothing was made of step {index}"))
    }

    fn labels(&self) -> Vec<Preference> {
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
        assert_eq!(made.label, Preference::Expert);
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
fn an_episode_that_the_time_limit_cuts_off_has_an_unknown_successor() {
    // Episodes of two, three and one ticks.
    let episodes = [0, 0, 1, 1, 1, 2, 3];
    for (limit, ends) in [
        (None, [Then::End, Then::End, Then::End]),
        (Some(3), [Then::End, Then::Unknown, Then::End]),
        (Some(2), [Then::Unknown, Then::Unknown, Then::End]),
    ] {
        let mut bench = Bench::truncated_at(GateMode::Expert, limit);
        for (tick, episode) in episodes.into_iter().enumerate() {
            bench.push(of_episode(step(tick as u64), episode));
        }
        bench.finish();
        assert_eq!([1, 4, 5].map(|index| bench.of(index).then), ends);
        assert_eq!(bench.of(3).then, Then::On);
    }
}

#[test]
fn a_step_of_the_last_tick_of_all_has_no_next() {
    let mut bench = Bench::truncated_at(GateMode::Expert, Some(3));
    let mut last = step(0);
    last.observation.header.tick = u64::MAX;
    bench.push(last);
    bench.push(of_episode(step(1), 1));
    bench.finish();
    assert_eq!(bench.of(0).then, Then::Unknown);
}

#[test]
fn an_episode_whose_beginning_was_missed_may_have_reached_the_time_limit() {
    // The first steps of the run, and of the second episode, are missing.
    let received = [(3, 0), (4, 0), (7, 1), (8, 1), (9, 2), (10, 3)];
    for (limit, end) in [(None, Then::End), (Some(100), Then::Unknown)] {
        let mut bench = Bench::truncated_at(GateMode::Expert, limit);
        for (tick, episode) in received {
            bench.push(of_episode(step(tick), episode));
        }
        bench.finish();
        assert_eq!(bench.of(1).then, Then::Unknown, "steps were lost");
        assert_eq!(bench.of(3).then, end);
        assert_eq!(bench.of(4).then, Then::End, "received as a whole");
    }
}

#[test]
fn after_a_missed_episode_the_successor_is_unknown() {
    let mut bench = Bench::new(GateMode::Expert);
    bench.push(step(0));
    bench.push(of_episode(step(1), 2));
    bench.finish();
    assert_eq!(bench.of(0).then, Then::Unknown);
}

#[test]
fn a_lost_step_is_counted_and_ends_the_transition_before_it() {
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
fn steps_before_the_first_one_received_are_lost() {
    let mut bench = Bench::new(GateMode::Expert);
    bench.push(step(7));
    assert_eq!(bench.counts().lost, 7);
    // A restarted learner knows the number of the last step it received.
    let mut again = Bench::new(GateMode::Expert);
    again.assembler.follows((CONTROLLER, 6));
    again.push(step(7));
    assert_eq!(again.counts().lost, 1);
}

#[test]
fn steps_of_a_restarted_controller_before_the_first_one_received_are_lost() {
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
    assert_eq!(labels[..4], [Preference::Expert; 4]);
    assert_eq!(
        labels[4..],
        [Preference::Abstain; 5],
        "the question was about another world"
    );
}

#[test]
fn labels_of_a_run_do_not_reach_a_run_on_another_clock() {
    let mut bench = Bench::new(GateMode::Rules);
    for tick in 100..104 {
        // The other run counts from 1, like any run.
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
        // An early question of this run; its window holds ticks 2 to 11.
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
        "no transition of the first run waits any longer"
    );
    bench.finish();
    assert_eq!(bench.of(4).then, Then::Unknown);
    assert_eq!(bench.labels(), [Preference::Abstain; 17]);
}

#[test]
fn a_swap_of_weights_ends_no_transition() {
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
    assert_eq!(bench.of(0).label, Preference::Expert);
    let mut policy = Bench::new(GateMode::Policy);
    policy.push(step(0));
    policy.push(vetoed(step(1)));
    policy.finish();
    assert_eq!(policy.labels(), [Preference::Abstain, Preference::Expert]);
}

#[test]
fn a_late_answer_labels_the_steps_of_its_window_and_no_other() {
    for (preference, label) in [
        (Preference::Expert, Preference::Expert),
        (Preference::Policy, Preference::Policy),
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
                false => Preference::Abstain,
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
        [Preference::Policy, Preference::Expert, Preference::Policy]
    );
}

#[test]
fn an_abstention_makes_no_label_and_ends_the_wait() {
    let mut bench = Bench::new(GateMode::Rules);
    for tick in 0..5 {
        bench.push(advised(step(tick), (1, 0), Preference::Abstain));
    }
    assert_eq!(bench.made.len(), 4);
    bench.finish();
    assert_eq!(bench.labels(), [Preference::Abstain; 5]);
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
    assert_eq!(bench.of(0).label, Preference::Abstain);
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
    assert_eq!(labels[..5], [Preference::Abstain; 5]);
    assert_eq!(labels[5..8], [Preference::Expert; 3]);
    assert_eq!(labels[8..], [Preference::Abstain; 4]);
}

#[test]
fn an_observation_counts_once_however_long_it_stays_the_newest() {
    let mut bench = Bench::new(GateMode::Rules);
    for tick in 0..10 {
        let mut step = advised(step(tick), (1, 0), Preference::Expert);
        if (2..6).contains(&tick) {
            // The world is late: the observation of tick 1 is still the newest.
            step.observation = self::step(1).observation;
        }
        bench.push(step);
    }
    bench.finish();
    assert_eq!(bench.counts().unseen, 4);
    assert_eq!(bench.made.len(), 6);
    assert_eq!(bench.counts().cut, 2, "tick 1 and the last");
    let labels: Vec<Preference> = bench.made.iter().map(|made| made.label).collect();
    assert_eq!(
        labels,
        [Preference::Expert; 6],
        "the question's episode went on"
    );
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
