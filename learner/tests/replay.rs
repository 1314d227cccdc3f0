//! The rings: what they hold, what they forget, what is drawn from them.

use learner::replay::{ACTIONS, Batch, Label, Replay, Ring, Then, Transition};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use shm_config::message::FEATURES;

/// A transition that can be told from others by its pedal, which no mirror turns.
fn numbered(number: u32, label: Label) -> Transition {
    Transition {
        state: [0.5; FEATURES],
        next: [0.5; FEATURES],
        applied: [0.1, number as f32],
        policy: [0.2, number as f32],
        expert: [0.3, number as f32],
        label,
        then: Then::On,
    }
}

fn numbers(replay: &Replay, ring: Ring) -> Vec<u32> {
    replay
        .iter(ring)
        .map(|held| held.applied[1] as u32)
        .collect()
}

fn drawn(batch: &Batch) -> Vec<u32> {
    let rows = batch.applied.chunks_exact(ACTIONS);
    rows.map(|action| action[1] as u32).collect()
}

#[test]
fn a_full_ring_forgets_the_oldest_and_only_its_own() {
    let mut replay = Replay::new(5);
    replay.push(Ring::Learner, numbered(1000, Label::None));
    for number in 0..13 {
        replay.push(Ring::Expert, numbered(number, Label::Expert));
        let oldest = (number + 1).saturating_sub(5);
        let expected: Vec<u32> = (oldest..=number).collect();
        assert_eq!(numbers(&replay, Ring::Expert), expected);
        assert_eq!(replay.len(Ring::Expert), expected.len());
    }
    assert_eq!(numbers(&replay, Ring::Learner), [1000]);
    assert_eq!(replay.len(Ring::Predicted), 0);
}

#[test]
fn labels_choose_the_ring() {
    let ring = |label| numbered(0, label).ring();
    assert_eq!(ring(Label::Expert), Ring::Expert);
    assert_eq!(ring(Label::Policy), Ring::Learner);
    assert_eq!(ring(Label::None), Ring::Learner);
}

#[test]
fn half_of_an_even_sample_prefers_the_expert_however_few_do() {
    let mut replay = Replay::new(1000);
    for number in 0..3 {
        replay.push(Ring::Expert, numbered(number, Label::Expert));
    }
    for number in 100..900 {
        replay.push(Ring::Learner, numbered(number, Label::Policy));
    }
    replay.push(Ring::Predicted, numbered(9000, Label::Expert));
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut batch = Batch::default();
    let mut seen = [0; 3];
    for _ in 0..20 {
        replay.sample_evenly(64, &mut random, &mut batch);
        assert_eq!(batch.len(), 64);
        let drawn = drawn(&batch);
        let preferred = drawn.iter().filter(|&&number| number < 100).count();
        assert_eq!(preferred, 32);
        assert_eq!(batch.is_preferred.iter().sum::<f32>(), 32.0);
        assert!(
            drawn.iter().all(|&number| number < 9000),
            "predicted states have a ring of their own"
        );
        for number in drawn.into_iter().filter(|&number| number < 3) {
            seen[number as usize] += 1;
        }
    }
    // 640 draws of three: each within ten standard deviations of its share.
    assert!(
        seen.iter().all(|count| (100..330).contains(count)),
        "seed 1: {seen:?}"
    );
}

#[test]
fn an_even_sample_of_one_ring_is_whole() {
    for (ring, label) in [(Ring::Expert, Label::Expert), (Ring::Learner, Label::None)] {
        let mut replay = Replay::new(10);
        replay.push(ring, numbered(7, label));
        let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
        let mut batch = Batch::default();
        replay.sample_evenly(9, &mut random, &mut batch);
        assert_eq!(drawn(&batch), [7; 9], "{ring:?}");
    }
}

#[test]
fn nothing_is_drawn_from_empty_rings() {
    let mut replay = Replay::new(10);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut batch = Batch::default();
    replay.push(Ring::Predicted, numbered(0, Label::Expert));
    replay.sample_evenly(8, &mut random, &mut batch);
    assert!(batch.is_empty());
    replay.sample(&[Ring::Expert, Ring::Learner], 8, &mut random, &mut batch);
    assert!(batch.is_empty());
}

#[test]
fn rings_are_drawn_from_by_their_sizes() {
    let mut replay = Replay::new(1000);
    for number in 0..300 {
        replay.push(Ring::Expert, numbered(number, Label::Expert));
    }
    for number in 1000..1100 {
        replay.push(Ring::Predicted, numbered(number, Label::Expert));
    }
    let mut random = Xoshiro256PlusPlus::seed_from_u64(2);
    let mut batch = Batch::default();
    replay.sample(
        &[Ring::Expert, Ring::Predicted],
        4000,
        &mut random,
        &mut batch,
    );
    assert_eq!(batch.len(), 4000);
    let predicted = drawn(&batch)
        .iter()
        .filter(|&&number| number >= 1000)
        .count();
    // A quarter, within ten standard deviations.
    assert!((725..1275).contains(&predicted), "seed 2: {predicted}");
}

#[test]
fn about_half_of_a_sample_is_seen_in_the_mirror() {
    let mut replay = Replay::new(10);
    replay.push(Ring::Expert, numbered(1, Label::Expert));
    let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
    let mut batch = Batch::default();
    replay.sample_evenly(1000, &mut random, &mut batch);
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
        "all actions of a row turn together"
    );
    assert_eq!(turned, mirrored(&batch.policy));
    let count = turned.iter().filter(|&&turned| turned).count();
    assert!((340..660).contains(&count), "seed 3: {count}");
}
