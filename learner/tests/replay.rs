//! Tests of the replay buffers: what they hold, what they drop, and what is drawn from
//! them.

use learner::features::prepare;
use learner::replay::{ACTIONS, Batch, Buffer, INPUTS, Replay, Then, Transition};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use shm_config::message::{FEATURES, Preference};

/// The index of the speed, which mirroring leaves unchanged.
const SPEED: usize = 3;

/// A transition that is identified by its pedal, which mirroring leaves unchanged, and by a
/// number of its states that it leaves unchanged, too.
fn numbered(number: u32, label: Preference) -> Transition {
    let (mut state, mut next) = ([0.5; INPUTS], [0.5; INPUTS]);
    (state[SPEED], next[SPEED]) = (number as f32, number as f32 + 0.5);
    Transition {
        state,
        next,
        applied: [0.1, number as f32],
        policy: [0.2, number as f32],
        expert: [0.3, number as f32],
        label,
        then: Then::On,
    }
}

fn numbers(replay: &Replay, buffer: Buffer) -> Vec<u32> {
    replay
        .iter(buffer)
        .map(|held| held.applied[1] as u32)
        .collect()
}

fn drawn(batch: &Batch) -> Vec<u32> {
    let rows = batch.applied.chunks_exact(ACTIONS);
    rows.map(|action| action[1] as u32).collect()
}

#[test]
fn a_full_buffer_drops_its_oldest_transition_alone() {
    let mut replay = Replay::new(5);
    replay.push(Buffer::Learner, numbered(1000, Preference::Abstain));
    for number in 0..13 {
        replay.push(Buffer::Expert, numbered(number, Preference::Expert));
        let oldest = (number + 1).saturating_sub(5);
        let expected: Vec<u32> = (oldest..=number).collect();
        assert_eq!(numbers(&replay, Buffer::Expert), expected);
        assert_eq!(replay.len(Buffer::Expert), expected.len());
    }
    assert_eq!(numbers(&replay, Buffer::Learner), [1000]);
    assert_eq!(replay.len(Buffer::Predicted), 0);
}

#[test]
fn the_label_chooses_the_buffer() {
    let buffer = |label| numbered(0, label).buffer();
    assert_eq!(buffer(Preference::Expert), Buffer::Expert);
    assert_eq!(buffer(Preference::Policy), Buffer::Learner);
    assert_eq!(buffer(Preference::Abstain), Buffer::Learner);
}

#[test]
fn half_of_an_even_sample_prefers_the_expert_however_few_do() {
    let mut replay = Replay::new(1000);
    for number in 0..3 {
        replay.push(Buffer::Expert, numbered(number, Preference::Expert));
    }
    for number in 100..900 {
        replay.push(Buffer::Learner, numbered(number, Preference::Policy));
    }
    replay.push(Buffer::Predicted, numbered(9000, Preference::Expert));
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut batch = Batch::default();
    let mut seen = [0; 3];
    for _ in 0..20 {
        replay.sample_evenly(64, &mut random, 1, &mut batch);
        assert_eq!(batch.len(), 64);
        let drawn = drawn(&batch);
        let preferred = drawn.iter().filter(|&&number| number < 100).count();
        assert_eq!(preferred, 32);
        assert_eq!(batch.is_preferred.iter().sum::<f32>(), 32.0);
        assert!(
            drawn.iter().all(|&number| number < 9000),
            "predicted states have a buffer of their own"
        );
        for number in drawn.into_iter().filter(|&number| number < 3) {
            seen[number as usize] += 1;
        }
    }
    // 640 draws of three buffers: each count lies within ten standard deviations of its
    // share.
    assert!(
        seen.iter().all(|count| (100..330).contains(count)),
        "seed 1: {seen:?}"
    );
}

#[test]
fn an_even_sample_of_one_buffer_is_complete() {
    for (buffer, label) in [
        (Buffer::Expert, Preference::Expert),
        (Buffer::Learner, Preference::Abstain),
    ] {
        let mut replay = Replay::new(10);
        replay.push(buffer, numbered(7, label));
        let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
        let mut batch = Batch::default();
        replay.sample_evenly(9, &mut random, 1, &mut batch);
        assert_eq!(drawn(&batch), [7; 9], "{buffer:?}");
    }
}

#[test]
fn nothing_is_drawn_from_empty_buffers() {
    let mut replay = Replay::new(10);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut batch = Batch::default();
    replay.push(Buffer::Predicted, numbered(0, Preference::Expert));
    replay.sample_evenly(8, &mut random, 1, &mut batch);
    assert!(batch.is_empty());
    replay.sample(
        &[Buffer::Expert, Buffer::Learner],
        8,
        &mut random,
        1,
        &mut batch,
    );
    assert!(batch.is_empty());
}

#[test]
fn of_an_earlier_batch_nothing_is_left() {
    let mut replay = Replay::new(10);
    replay.push(Buffer::Expert, numbered(7, Preference::Expert));
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut batch = Batch::default();
    replay.sample_evenly(8, &mut random, 1, &mut batch);
    assert_eq!(batch.nexts.len(), 8 * FEATURES);
    replay.sample(&Buffer::ALL, 3, &mut random, 1, &mut batch);
    assert_eq!((batch.states.len(), batch.nexts.len()), (3 * FEATURES, 0));
    let empty = Replay::new(10);
    for evenly in [true, false] {
        replay.sample_evenly(8, &mut random, 1, &mut batch);
        match evenly {
            true => empty.sample_evenly(8, &mut random, 1, &mut batch),
            false => empty.sample(&Buffer::ALL, 8, &mut random, 1, &mut batch),
        }
        assert!(batch.is_empty() && batch.states.is_empty() && batch.nexts.is_empty());
    }
}

#[test]
fn buffers_are_sampled_in_proportion_to_their_sizes() {
    let mut replay = Replay::new(1000);
    for number in 0..300 {
        replay.push(Buffer::Expert, numbered(number, Preference::Expert));
    }
    for number in 1000..1100 {
        replay.push(Buffer::Predicted, numbered(number, Preference::Expert));
    }
    let mut random = Xoshiro256PlusPlus::seed_from_u64(2);
    let mut batch = Batch::default();
    replay.sample(
        &[Buffer::Expert, Buffer::Predicted],
        4000,
        &mut random,
        1,
        &mut batch,
    );
    assert_eq!(batch.len(), 4000);
    let predicted = drawn(&batch)
        .iter()
        .filter(|&&number| number >= 1000)
        .count();
    // The share is a quarter, within ten standard deviations.
    assert!((725..1275).contains(&predicted), "seed 2: {predicted}");
}

#[test]
fn any_number_of_threads_draws_the_same() {
    let mut replay = Replay::new(1000);
    for number in 0..100 {
        let label = [Preference::Expert, Preference::Policy][number as usize % 2];
        let transition = numbered(number, label);
        replay.push(transition.buffer(), transition);
    }
    let draw = |threads: usize| {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(4);
        let [mut evenly, mut all] = [(); 2].map(|()| Batch::default());
        replay.sample_evenly(301, &mut random, threads, &mut evenly);
        replay.sample(&Buffer::ALL, 301, &mut random, threads, &mut all);
        for (batch, has_nexts) in [(&evenly, true), (&all, false)] {
            let numbers = drawn(batch);
            let speeds = |rows: &[f32]| -> Vec<f32> {
                rows.iter().skip(SPEED).step_by(FEATURES).copied().collect()
            };
            let prepared = |later: f32| -> Vec<f32> {
                let speed = |number: &u32| {
                    let mut row = [0.5; FEATURES];
                    row[SPEED] = *number as f32 + later;
                    prepare(&mut row);
                    row[SPEED]
                };
                numbers.iter().map(speed).collect()
            };
            assert_eq!(speeds(&batch.states), prepared(0.0), "{threads} threads");
            let nexts = if has_nexts { prepared(0.5) } else { Vec::new() };
            assert_eq!(speeds(&batch.nexts), nexts, "{threads} threads");
        }
        // In turn, and the odd one is the learner's.
        let is_experts = drawn(&evenly).into_iter().map(|number| number % 2 == 0);
        assert!(is_experts.enumerate().all(|(k, is)| is == (k % 2 == 1)));
        [evenly.states, evenly.nexts, evenly.expert, all.states]
    };
    let one = draw(1);
    assert_eq!(one[0].len(), one[3].len());
    for threads in [0, 2, 3] {
        assert_eq!(draw(threads), one, "{threads} threads");
    }
}

#[test]
fn about_half_of_a_sample_is_mirrored() {
    let mut replay = Replay::new(10);
    replay.push(Buffer::Expert, numbered(1, Preference::Expert));
    let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
    let mut batch = Batch::default();
    replay.sample_evenly(1000, &mut random, 1, &mut batch);
    let mirrored = |actions: &[f32]| -> Vec<bool> {
        actions
            .chunks_exact(ACTIONS)
            .map(|action| action[0] < 0.0)
            .collect()
    };
    let turned = mirrored(&batch.expert);
    assert_eq!(
        turned,
        mirrored(&batch.applied),
        "all actions of a row are mirrored together"
    );
    assert_eq!(turned, mirrored(&batch.policy));
    let count = turned.iter().filter(|&&turned| turned).count();
    assert!((340..660).contains(&count), "seed 3: {count}");
}
