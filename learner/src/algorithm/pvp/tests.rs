use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use shm_config::message::{FEATURES, Preference};

use super::{Pvp, Settings, StateActions, Term, VALUE_BOUND};
use crate::Rate;
use crate::algorithm::{Learned, Size};
use crate::replay::{ACTIONS, INPUTS, Replay, Then, Transition};

/// Directions in parameter space that are tried.
const DIRECTIONS: usize = 20;
/// Finite difference. With a smaller one f32 rounds the difference away; with a larger
/// one more ReLUs change sides.
const CRITIC_EPSILON: f32 = 4e-3;
/// The same for the actor, whose loss is smaller and has more curvature.
const ACTOR_EPSILON: f32 = 1e-3;
/// Relative error in the median direction: what f32 and the curvature leave.
const TOLERANCE: f64 = 0.03;
/// Relative error in a direction in which ReLUs change sides within epsilon.
const KINKED: f64 = 0.15;

/// A learner with a drawn batch that holds all kinds of transitions.
fn drawn(seed: u64) -> Pvp {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut replay = Replay::new(100);
    for k in 0..60 {
        let mut numbers = |scale: f32| -> [f32; INPUTS] {
            std::array::from_fn(|_| 0.5 + scale * random.random_range(-0.5..0.5))
        };
        let (state, next) = (numbers(0.5), numbers(0.5));
        let mut pair = || {
            [
                random.random_range(-1.0..1.0),
                random.random_range(-1.0..1.0),
            ]
        };
        let (applied, policy, other) = (pair(), pair(), pair());
        let transition = Transition {
            state,
            next,
            applied,
            policy,
            // Outside a test this happens only in a hand-over.
            expert: [applied, other][k / 3 % 2],
            label: [Preference::Expert, Preference::Policy, Preference::Abstain][k % 3],
            then: [Then::On, Then::On, Then::End, Then::Unknown][k % 4],
        };
        replay.push(transition.buffer(), transition);
    }
    let size = Size {
        inputs: FEATURES,
        hidden: 12,
        filters: 0,
        batch: 32,
    };
    let settings = Settings {
        imitation_weight: 0.7,
        imitation_steer: 3.0,
        critic_scale: [2.0, 1.5],
        ..Settings::published(Rate::constant(1e-3))
    };
    let mut pvp = Pvp::new(settings, size, &mut random);
    replay.sample_evenly(size.batch, &mut random, 1, &mut pvp.workspace.batch);
    pvp.targets(&mut random, 1);
    pvp
}

/// Compares the gradient of one network with central differences of the loss in random
/// directions.
fn assert_gradient(
    (seed, epsilon): (u64, f32),
    network: impl Fn(&mut Pvp) -> &mut Learned,
    loss: impl Fn(&mut Pvp) -> f32,
    errors: &mut Vec<f64>,
) {
    let mut pvp = drawn(seed);
    loss(&mut pvp);
    let gradient = network(&mut pvp).gradient.clone();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed ^ 1);
    for k in 0..DIRECTIONS {
        // Near the direction of the gradient.
        let direction: Vec<f32> = gradient
            .iter()
            .map(|slope| slope.signum() * random.random_range(-0.2..1.0_f32))
            .collect();
        let length = direction.iter().map(|d| d * d).sum::<f32>().sqrt();
        let mut at = |by: f32| {
            let parameters = network(&mut pvp).network.parameters_mut();
            let before = parameters.to_vec();
            for (parameter, d) in parameters.iter_mut().zip(&direction) {
                *parameter += by * d / length;
            }
            let value = f64::from(loss(&mut pvp));
            network(&mut pvp)
                .network
                .parameters_mut()
                .copy_from_slice(&before);
            value
        };
        let difference = (at(epsilon) - at(-epsilon)) / (2.0 * f64::from(epsilon));
        let pairs = gradient.iter().zip(&direction);
        let slope: f64 = pairs.map(|(g, d)| f64::from(g * d / length)).sum();
        let error = (difference - slope).abs() / slope.abs();
        assert!(
            error < KINKED,
            "seed {seed}, direction {k}: {slope}, by differences {difference}"
        );
        errors.push(error);
    }
}

fn assert_median(mut errors: Vec<f64>) {
    errors.sort_by(f64::total_cmp);
    let median = errors[errors.len() / 2];
    assert!(median < TOLERANCE, "{median}, all of them: {errors:.3?}");
}

#[test]
fn the_critics_gradients_are_those_of_finite_differences() {
    let mut errors = Vec::new();
    for seed in 0..4 {
        for k in 0..2 {
            assert_gradient(
                (seed, CRITIC_EPSILON),
                |pvp| &mut pvp.critics[k],
                |pvp| pvp.critic_loss(1),
                &mut errors,
            );
        }
    }
    assert_median(errors);
}

#[test]
fn the_actors_gradient_is_that_of_finite_differences() {
    let mut errors = Vec::new();
    for seed in 0..4 {
        let loss = |pvp: &mut Pvp| pvp.actor_loss(1).actor;
        assert_gradient(
            (seed, ACTOR_EPSILON),
            |pvp| &mut pvp.actor,
            loss,
            &mut errors,
        );
    }
    assert_median(errors);
}

#[test]
fn an_eased_hand_over_is_judged_by_what_the_expert_proposed() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
    let mut pvp = drawn(5);
    let mut replay = Replay::new(10);
    // The test changes the pedal, which mirroring leaves unchanged.
    let transition = Transition {
        state: [0.5; INPUTS],
        next: [0.5; INPUTS],
        applied: [0.0, 0.6],
        policy: [0.0, 0.9],
        expert: [0.0, -0.6],
        label: Preference::Expert,
        then: Then::Unknown,
    };
    replay.push(transition.buffer(), transition);
    replay.sample_evenly(8, &mut random, 1, &mut pvp.workspace.batch);
    let (mut valued, targets) = (StateActions::default(), [0.5; 8]);
    valued.of_loss(&pvp.workspace.batch, &targets, [1.0; 2]);
    let pedals = valued.actions.chunks_exact(ACTIONS).map(|pair| pair[1]);
    let asked: Vec<_> = pedals.zip(valued.terms).collect();
    let term = |target: f32, weight: f32| Term { target, weight };
    // What followed is not known, so that the applied action has no value to reach.
    let nothing = term(0.0, 0.0);
    let expected = [
        (0.6, [term(0.5, 0.0), nothing]),
        (0.9, [term(-1.0, 1.0), nothing]),
        (-0.6, [term(1.0, 1.0), nothing]),
    ];
    assert_eq!(asked, expected.repeat(8));
    assert_eq!(valued.counts, [3; 8]);
    // The actor imitates the expert's proposal too.
    let states = pvp.workspace.batch.states.clone();
    let mut tape = crate::network::Tape::default();
    let action = pvp.actor.network.forward(&states[..FEATURES], 1, &mut tape);
    let off = (action[1] + 0.6).powi(2);
    let steer: f32 = pvp.settings.imitation_steer * action[0].powi(2);
    replay.sample_evenly(1, &mut random, 1, &mut pvp.workspace.batch);
    pvp.workspace.batch.states = states[..FEATURES].to_vec();
    let imitation = pvp.actor_loss(1).imitation;
    assert!(
        (imitation - 0.5 * (off + steer)).abs() < 1e-3,
        "{imitation}"
    );
}

#[test]
fn an_applied_proposal_is_valued_once_and_has_two_terms() {
    let mut pvp = drawn(7);
    let batch = &mut pvp.workspace.batch;
    batch.applied[..4].copy_from_slice(&[0.5, 0.6, 0.1, 0.2]);
    batch.policy[..4].copy_from_slice(&[-0.5, 0.4, 0.1, 0.2]);
    batch.expert[..4].copy_from_slice(&[0.5, 0.6, 0.3, 0.3]);
    batch.is_preferred[..2].copy_from_slice(&[1.0, 0.0]);
    batch.is_known[..2].copy_from_slice(&[1.0, 1.0]);
    let mut valued = StateActions::default();
    valued.of_loss(batch, &[0.25, 0.75], [2.0, 10.0]);
    let term = |target: f32, weight: f32| Term { target, weight };
    assert_eq!(valued.counts, [2, 1]);
    assert_eq!(valued.actions, [1.0, 6.0, -1.0, 4.0, 0.2, 2.0]);
    let nothing = term(0.0, 0.0);
    let expected = [
        [term(0.25, 1.0), term(1.0, 1.0)],
        [term(-1.0, 1.0), nothing],
        [term(0.75, 1.0), nothing],
    ];
    assert_eq!(valued.terms, expected);
}

#[test]
fn the_critics_loss_is_the_mean_over_the_batch_of_its_terms() {
    let mut pvp = drawn(11);
    let loss = pvp.critic_loss(1);
    let (batch, scale) = (&pvp.workspace.batch, pvp.settings.critic_scale);
    let mut expected = 0.0;
    for critic in &pvp.critics {
        for k in 0..batch.len() {
            let value = |actions: &[f32]| {
                let state = &batch.states[k * FEATURES..(k + 1) * FEATURES];
                let action = &actions[k * ACTIONS..(k + 1) * ACTIONS];
                let scaled = [action[0] * scale[0], action[1] * scale[1]];
                let mut tape = crate::network::Tape::default();
                critic
                    .network
                    .forward(&[state, &scaled].concat(), 1, &mut tape)[0]
            };
            let target = pvp.workspace.values[k];
            expected += batch.is_known[k] * (value(&batch.applied) - target).powi(2);
            let of_preference = (value(&batch.expert) - VALUE_BOUND).powi(2)
                + (value(&batch.policy) + VALUE_BOUND).powi(2);
            expected += batch.is_preferred[k] * of_preference;
        }
    }
    expected /= batch.len() as f32;
    assert!((loss / expected - 1.0).abs() < 1e-4, "{loss}, {expected}");
}

#[test]
fn a_replay_without_preferences_is_learnt_from_all_the_same() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
    let mut pvp = drawn(3);
    let mut replay = Replay::new(10);
    let transition = Transition {
        state: [0.5; INPUTS],
        next: [0.4; INPUTS],
        applied: [0.1, 0.2],
        policy: [0.3, 0.4],
        expert: [0.5, 0.6],
        label: Preference::Abstain,
        then: Then::On,
    };
    replay.push(transition.buffer(), transition);
    for _ in 0..10 {
        let losses = pvp.update(&replay, &mut random, 1);
        assert!(
            losses.critic.is_finite() && losses.actor.is_finite(),
            "{losses:?}"
        );
    }
    assert!(
        pvp.policy()
            .parameters()
            .iter()
            .all(|value| value.is_finite())
    );
}

#[test]
fn targets_end_with_the_episode_and_are_the_lesser_of_two() {
    let mut pvp = drawn(9);
    let values = pvp.workspace.values.clone();
    assert_eq!(values.len(), 32);
    for (value, goes_on) in values.iter().zip(&pvp.workspace.batch.goes_on) {
        assert_eq!(*value == 0.0, *goes_on == 0.0, "{value}");
    }
    // With one target far above, the other one is used.
    let last = pvp.critic_targets[0].parameters().len() - 1;
    pvp.critic_targets[0].parameters_mut()[last] += 100.0;
    pvp.targets(&mut Xoshiro256PlusPlus::seed_from_u64(1), 1);
    assert!(pvp.workspace.values.iter().all(|value| value.abs() < 10.0));
    assert_eq!(ACTIONS * 32, pvp.workspace.actions.len());
}
