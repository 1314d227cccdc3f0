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
mod tests;
