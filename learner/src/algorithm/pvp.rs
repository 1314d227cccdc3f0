//! PVP: a proxy value from preferences, spread along the trajectory by temporal
//! differences without a reward, and an actor that follows it (Sec. 4.3).
//!
//! After PVP4Real, whose numbers stand where the paper gives none.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use shm_config::message::FEATURES;

use super::{Learned, Losses, Size, actor};
use crate::network::{Head, Network, Tape};
use crate::replay::{ACTIONS, Batch, Replay};

/// Discount; PVP4Real.
const GAMMA: f32 = 0.99;
/// Share by which targets follow; PVP4Real.
const TAU: f32 = 0.005;
/// Updates of the critics for one of the actor; PVP4Real.
const POLICY_DELAY: u64 = 2;
/// Bound of the noise on target actions, in its standard deviations; TD3.
const TARGET_NOISE_CLIP: f32 = 2.5;
/// Value of a preferred action, and less this of a rejected one; PVP4Real.
const VALUE_BOUND: f32 = 1.0;
/// Keeps the mean over interventions finite; PVP4Real.
const FEW: f32 = 1e-5;

/// The hyper-parameters that the configuration may change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Length of Adam's steps for all networks; PVP4Real has 1e-4.
    pub rate: f32,
    /// `lambda_BC` of Eq. 2; PVP4Real has 1.
    pub imitation_weight: f32,
    /// Standard deviation of the noise on target actions; TD3 has 0.2.
    pub target_noise: f32,
}

/// Twin critics and an actor.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Pvp {
    settings: Settings,
    size: Size,
    actor: Learned,
    critics: [Learned; 2],
    actor_target: Network,
    critic_targets: [Network; 2],
    updates: u64,
    #[serde(skip)]
    last_actor: Losses,
    #[serde(skip)]
    room: Room,
}

/// What an update writes to, kept from one to the next.
#[derive(Clone, Debug, Default)]
struct Room {
    batch: Batch,
    tape: Tape,
    critic_tape: Tape,
    actions: Vec<f32>,
    inputs: Vec<f32>,
    values: Vec<f32>,
    delta: Vec<f32>,
    slope: Vec<f32>,
    bounds: Vec<f32>,
}

impl Pvp {
    /// With fresh networks.
    pub fn new(settings: Settings, size: Size, random: &mut impl Rng) -> Pvp {
        let actor = actor(size, settings.rate, random);
        let sizes = [FEATURES + ACTIONS, size.hidden, size.hidden, 1];
        let critics = [(), ()].map(|()| Learned::new(&sizes, Head::Linear, settings.rate, random));
        Pvp {
            settings,
            size,
            actor_target: actor.network.clone(),
            critic_targets: [0, 1].map(|k| critics[k].network.clone()),
            actor,
            critics,
            updates: 0,
            last_actor: Losses::default(),
            room: Room::default(),
        }
    }

    /// `y = gamma min_i Q'_i(s', a')` where the episode went on: no reward.
    fn targets(&mut self, random: &mut impl Rng, threads: usize) {
        let Room {
            batch,
            tape,
            actions,
            inputs,
            values,
            ..
        } = &mut self.room;
        actions.clear();
        actions.extend_from_slice(self.actor_target.forward(&batch.nexts, threads, tape));
        for action in actions.iter_mut() {
            let noise = normal(random).clamp(-TARGET_NOISE_CLIP, TARGET_NOISE_CLIP);
            *action = (*action + self.settings.target_noise * noise).clamp(-1.0, 1.0);
        }
        join(&batch.nexts, actions, inputs);
        values.clear();
        values.extend_from_slice(self.critic_targets[0].forward(inputs, threads, tape));
        let second = self.critic_targets[1].forward(inputs, threads, tape);
        for ((value, second), goes_on) in values.iter_mut().zip(second).zip(&batch.goes_on) {
            *value = goes_on * GAMMA * value.min(*second);
        }
    }

    /// For each critic `[Q(s, a_applied) - y]^2 + I [Q(s, a_expert) - 1]^2
    /// + I [Q(s, a_policy) + 1]^2`, means over the batch, and its gradient.
    fn judge_critics(&mut self, threads: usize) -> f32 {
        let Room {
            batch,
            tape,
            critic_tape,
            inputs,
            values,
            delta,
            slope: judged,
            bounds,
            ..
        } = &mut self.room;
        let share = 1.0 / batch.len() as f32;
        join(&batch.states, &batch.applied, inputs);
        join_judged(batch, judged, bounds);
        let mut loss = 0.0;
        for critic in &mut self.critics {
            let taken = critic.network.forward(inputs, threads, tape);
            delta.clear();
            for (k, &value) in taken.iter().enumerate() {
                let [td, margin] = [value - values[k], value - VALUE_BOUND];
                let known = batch.is_known[k];
                let preferred = batch.is_preferred[k] * f32::from(is_experts(batch, k));
                loss += share * (known * td * td + preferred * margin * margin);
                delta.push(2.0 * share * (known * td + preferred * margin));
            }
            let gradient = Some(&mut critic.gradient[..]);
            critic
                .network
                .backward((inputs, delta), threads, tape, gradient, None);
            let values = critic.network.forward(judged, threads, critic_tape);
            delta.clear();
            for (value, bound) in values.iter().zip(&*bounds) {
                let margin = value - bound;
                loss += share * margin * margin;
                delta.push(2.0 * share * margin);
            }
            let gradient = Some(&mut critic.gradient[..]);
            let pass = (&judged[..], &delta[..]);
            critic
                .network
                .backward(pass, threads, critic_tape, gradient, None);
        }
        loss
    }

    /// Eq. 2: `-mean Q(s, mu(s)) + lambda_BC` times Eq. 1, and its gradient.
    fn judge_actor(&mut self, threads: usize) -> Losses {
        let Room {
            batch,
            tape,
            critic_tape,
            actions,
            inputs,
            delta,
            slope,
            ..
        } = &mut self.room;
        let share = 1.0 / batch.len() as f32;
        actions.clear();
        actions.extend_from_slice(self.actor.network.forward(&batch.states, threads, tape));
        join(&batch.states, actions, inputs);
        let critic = &self.critics[0].network;
        let values = critic.forward(inputs, threads, critic_tape);
        let value = values.iter().sum::<f32>() * share;
        delta.clear();
        delta.resize(batch.len(), -share);
        critic.backward((inputs, delta), threads, critic_tape, None, Some(slope));
        delta.clear();
        for row in slope.chunks_exact(FEATURES + ACTIONS) {
            delta.extend_from_slice(&row[FEATURES..]);
        }
        let preferred = batch.is_preferred.iter().sum::<f32>() + FEW;
        let weight = self.settings.imitation_weight / (preferred * ACTIONS as f32);
        let mut imitation = 0.0;
        for (k, (action, expert)) in actions.iter().zip(&batch.expert).enumerate() {
            let error = batch.is_preferred[k / ACTIONS] * (action - expert);
            imitation += error * error / (preferred * ACTIONS as f32);
            delta[k] += 2.0 * weight * error;
        }
        let pass = (&batch.states[..], &delta[..]);
        let gradient = Some(&mut self.actor.gradient[..]);
        self.actor
            .network
            .backward(pass, threads, tape, gradient, None);
        Losses {
            actor: self.settings.imitation_weight * imitation - value,
            imitation,
            critic: 0.0,
        }
    }
}

impl Pvp {
    /// One update of the critics, every second time one of the actor.
    pub fn update(&mut self, replay: &Replay, random: &mut impl Rng, threads: usize) -> Losses {
        replay.sample_evenly(self.size.batch, random, &mut self.room.batch);
        if self.room.batch.is_empty() {
            return Losses::default();
        }
        self.targets(random, threads);
        let critic = self.judge_critics(threads);
        self.critics.iter_mut().for_each(Learned::step);
        self.updates += 1;
        if self.updates.is_multiple_of(POLICY_DELAY) {
            self.last_actor = self.judge_actor(threads);
            self.actor.step();
            self.actor_target.follow(&self.actor.network, TAU);
            for (target, critic) in self.critic_targets.iter_mut().zip(&self.critics) {
                target.follow(&critic.network, TAU);
            }
        }
        Losses {
            critic,
            ..self.last_actor
        }
    }

    /// What it was begun with, by configuration key.
    pub fn begun_with(&self) -> Vec<(&'static str, f64)> {
        let mut begun = self.size.begun_with(self.settings.rate);
        let weight = f64::from(self.settings.imitation_weight);
        begun.push(("learner.imitation_weight", weight));
        let noise = f64::from(self.settings.target_noise);
        begun.push(("learner.target_noise", noise));
        begun
    }

    /// The policy as it is now.
    pub fn policy(&self) -> &Network {
        &self.actor.network
    }
}

/// States and actions side by side: `batch x (FEATURES + ACTIONS)`.
fn join(states: &[f32], actions: &[f32], out: &mut Vec<f32>) {
    out.clear();
    let rows = states.chunks_exact(FEATURES);
    for (state, action) in rows.zip(actions.chunks_exact(ACTIONS)) {
        out.extend_from_slice(state);
        out.extend_from_slice(action);
    }
}

/// What was applied is what the expert proposed: but for hand-overs, which are
/// eased, it is, wherever the expert drives.
fn is_experts(batch: &Batch, row: usize) -> bool {
    let action = row * ACTIONS..(row + 1) * ACTIONS;
    batch.applied[action.clone()] == batch.expert[action]
}

/// Where the label prefers the expert: states with what the policy proposed, and
/// with what the expert did unless that was applied and is judged as such; and
/// the value that each should have.
fn join_judged(batch: &Batch, out: &mut Vec<f32>, bounds: &mut Vec<f32>) {
    out.clear();
    bounds.clear();
    for (k, state) in batch.states.chunks_exact(FEATURES).enumerate() {
        if batch.is_preferred[k] == 0.0 {
            continue;
        }
        let action = k * ACTIONS..(k + 1) * ACTIONS;
        out.extend_from_slice(state);
        out.extend_from_slice(&batch.policy[action.clone()]);
        bounds.push(-VALUE_BOUND);
        if !is_experts(batch, k) {
            out.extend_from_slice(state);
            out.extend_from_slice(&batch.expert[action]);
            bounds.push(VALUE_BOUND);
        }
    }
}

/// A normal number, by Box and Muller.
fn normal(random: &mut impl Rng) -> f32 {
    let radius = (-2.0 * (1.0 - random.random::<f32>()).ln()).sqrt();
    radius * (std::f32::consts::TAU * random.random::<f32>()).cos()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;
    use shm_config::message::FEATURES;

    use super::{Pvp, Settings};
    use crate::algorithm::{Learned, Size};
    use crate::replay::{ACTIONS, Label, Replay, Then, Transition};

    /// Directions in the space of the parameters that are tried.
    const DIRECTIONS: usize = 20;
    /// Shorter, and f32 rounds the difference away; longer, and more ReLUs turn.
    const CRITIC_EPSILON: f32 = 4e-3;
    /// The same for the actor, whose loss is smaller and bends more.
    const ACTOR_EPSILON: f32 = 1e-3;
    /// Of the slope, of most directions: what f32 and the curvature leave.
    const TOLERANCE: f64 = 0.03;
    /// Of the slope, where ReLUs turn within epsilon.
    const KINKED: f64 = 0.15;

    /// A learner with a batch drawn, all kinds of transitions in it.
    fn drawn(seed: u64) -> Pvp {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut replay = Replay::new(100);
        for k in 0..60 {
            let mut numbers = |scale: f32| -> [f32; FEATURES] {
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
                // Otherwise in a hand-over alone.
                expert: [applied, other][k / 3 % 2],
                label: [Label::Expert, Label::Policy, Label::None][k % 3],
                then: [Then::On, Then::On, Then::End, Then::Unknown][k % 4],
            };
            replay.push(transition.ring(), transition);
        }
        let size = Size {
            hidden: 12,
            batch: 32,
        };
        let settings = Settings {
            rate: 1e-3,
            imitation_weight: 0.7,
            target_noise: 0.2,
        };
        let mut pvp = Pvp::new(settings, size, &mut random);
        replay.sample_evenly(size.batch, &mut random, &mut pvp.room.batch);
        pvp.targets(&mut random, 1);
        pvp
    }

    /// Compares the gradient of one network with central differences of the
    /// loss in random directions.
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
            // Along the gradient, and a little aside.
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
                    |pvp| pvp.judge_critics(1),
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
            let loss = |pvp: &mut Pvp| pvp.judge_actor(1).actor;
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
        // The pedal, since a mirror leaves it as it is.
        let transition = Transition {
            state: [0.5; FEATURES],
            next: [0.5; FEATURES],
            applied: [0.0, 0.6],
            policy: [0.0, 0.9],
            expert: [0.0, -0.6],
            label: Label::Expert,
            then: Then::Unknown,
        };
        replay.push(transition.ring(), transition);
        replay.sample_evenly(8, &mut random, &mut pvp.room.batch);
        let (mut rows, mut bounds) = (Vec::new(), Vec::new());
        super::join_judged(&pvp.room.batch, &mut rows, &mut bounds);
        let pedals = rows
            .chunks_exact(FEATURES + ACTIONS)
            .map(|row| row[FEATURES + 1]);
        let judged: Vec<_> = pedals.zip(bounds).collect();
        assert_eq!(judged, [(0.9, -1.0), (-0.6, 1.0)].repeat(8));
        // The actor's imitation is of the expert, too.
        let states = pvp.room.batch.states.clone();
        let mut tape = crate::network::Tape::default();
        let action = pvp.actor.network.forward(&states[..FEATURES], 1, &mut tape);
        let off = (action[1] + 0.6).powi(2);
        let steer: f32 = action[0].powi(2);
        replay.sample_evenly(1, &mut random, &mut pvp.room.batch);
        pvp.room.batch.states = states[..FEATURES].to_vec();
        let imitation = pvp.judge_actor(1).imitation;
        assert!(
            (imitation - 0.5 * (off + steer)).abs() < 1e-3,
            "{imitation}"
        );
    }

    #[test]
    fn a_replay_without_preferences_is_learnt_from_all_the_same() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
        let mut pvp = drawn(3);
        let mut replay = Replay::new(10);
        let transition = Transition {
            state: [0.5; FEATURES],
            next: [0.4; FEATURES],
            applied: [0.1, 0.2],
            policy: [0.3, 0.4],
            expert: [0.5, 0.6],
            label: Label::None,
            then: Then::On,
        };
        replay.push(transition.ring(), transition);
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
        let values = pvp.room.values.clone();
        assert_eq!(values.len(), 32);
        for (value, goes_on) in values.iter().zip(&pvp.room.batch.goes_on) {
            assert_eq!(*value == 0.0, *goes_on == 0.0, "{value}");
        }
        // With one target far above, the other one counts.
        let last = pvp.critic_targets[0].parameters().len() - 1;
        pvp.critic_targets[0].parameters_mut()[last] += 100.0;
        pvp.targets(&mut Xoshiro256PlusPlus::seed_from_u64(1), 1);
        assert!(pvp.room.values.iter().all(|value| value.abs() < 10.0));
        assert_eq!(ACTIONS * 32, pvp.room.actions.len());
    }
}
