//! PVP: proxy values from preferences, spread along the trajectory by temporal
//! differences without a reward, and an actor that maximises them (Sec. 4.3).
//!
//! After PVP4Real, which supplies the numbers that the paper does not give.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use super::{Learned, Losses, Size, actor};
use crate::Rate;
use crate::network::{Head, Network, Tape};
use crate::replay::{ACTIONS, Batch, Replay};

/// Discount; PVP4Real.
const GAMMA: f32 = 0.99;
/// Polyak averaging factor (tau) of the target networks; PVP4Real.
const TAU: f32 = 0.005;
/// Critic updates for each actor update; PVP4Real.
const POLICY_DELAY: u64 = 2;
/// Bound of the noise on target actions, in standard deviations; TD3.
const TARGET_NOISE_CLIP: f32 = 2.5;
/// Value of a preferred action; a rejected action has the negative value; PVP4Real.
const VALUE_BOUND: f32 = 1.0;
/// Epsilon: keeps the mean over interventions finite; PVP4Real.
const EPSILON: f32 = 1e-5;

/// The hyper-parameters that the configuration can change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Learning rate of all networks; PVP4Real has 1e-4.
    pub rate: Rate,
    /// `lambda_BC` of Eq. 2; PVP4Real has 1.
    pub imitation_weight: f32,
    /// Standard deviation of the noise on target actions; TD3 has 0.2.
    pub target_noise: f32,
    /// How much more an error in steering counts in the imitation than one of the pedal;
    /// PVP4Real has 1.
    pub imitation_steer: f32,
    /// The critics see actions times this; PVP4Real has 1. Beside 259 features of size 1,
    /// two actions that differ by a tenth are nearly the same input.
    pub critic_scale: [f32; ACTIONS],
    /// Whether the policy is the actor's running average, its target network.
    pub is_averaged: bool,
}

impl Settings {
    /// Those of PVP4Real, with this learning rate.
    pub fn published(rate: Rate) -> Self {
        Self {
            rate,
            imitation_weight: 1.0,
            target_noise: 0.2,
            imitation_steer: 1.0,
            critic_scale: [1.0; ACTIONS],
            is_averaged: false,
        }
    }
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
    workspace: Workspace,
}

/// Buffers of an update, kept from one update to the next.
#[derive(Clone, Debug, Default)]
struct Workspace {
    batch: Batch,
    tape: Tape,
    critic_tape: Tape,
    actions: Vec<f32>,
    inputs: Vec<f32>,
    values: Vec<f32>,
    delta: Vec<f32>,
    judged: Vec<f32>,
    gradient: Vec<f32>,
    bounds: Vec<f32>,
}

impl Pvp {
    /// With random parameters.
    pub fn new(settings: Settings, size: Size, random: &mut impl Rng) -> Pvp {
        // It is updated less often.
        let rate = Rate {
            decay_steps: settings.rate.decay_steps.div_ceil(POLICY_DELAY as u32),
            ..settings.rate
        };
        let actor = actor(size, rate, random);
        let sizes = [size.inputs + ACTIONS, size.hidden, size.hidden, 1];
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
            workspace: Workspace::default(),
        }
    }

    /// The target `y = gamma min_i Q'_i(s', a')` where the episode continued; there is
    /// no reward.
    fn targets(&mut self, random: &mut impl Rng, threads: usize) {
        let Workspace {
            batch,
            tape,
            actions,
            inputs,
            values,
            ..
        } = &mut self.workspace;
        actions.clear();
        actions.extend_from_slice(self.actor_target.forward(&batch.nexts, threads, tape));
        for action in actions.iter_mut() {
            let noise = normal(random).clamp(-TARGET_NOISE_CLIP, TARGET_NOISE_CLIP);
            *action = (*action + self.settings.target_noise * noise).clamp(-1.0, 1.0);
        }
        join(&batch.nexts, actions, self.settings.critic_scale, inputs);
        values.clear();
        values.extend_from_slice(self.critic_targets[0].forward(inputs, threads, tape));
        let second = self.critic_targets[1].forward(inputs, threads, tape);
        for ((value, second), goes_on) in values.iter_mut().zip(second).zip(&batch.goes_on) {
            *value = goes_on * GAMMA * value.min(*second);
        }
    }

    /// The critics' loss and gradient: for each critic `[Q(s, a_applied) - y]^2 + I
    /// [Q(s, a_expert) - 1]^2 + I [Q(s, a_policy) + 1]^2`, averaged over the batch.
    fn critic_loss(&mut self, threads: usize) -> f32 {
        let Workspace {
            batch,
            tape,
            critic_tape,
            inputs,
            values,
            delta,
            judged,
            bounds,
            ..
        } = &mut self.workspace;
        let share = 1.0 / batch.len() as f32;
        let scale = self.settings.critic_scale;
        join(&batch.states, &batch.applied, scale, inputs);
        join_preferences(batch, scale, judged, bounds);
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

    /// The actor's loss and gradient, Eq. 2: `-mean Q(s, mu(s)) + lambda_BC` times Eq.
    /// 1.
    fn actor_loss(&mut self, threads: usize) -> Losses {
        let Workspace {
            batch,
            tape,
            critic_tape,
            actions,
            inputs,
            delta,
            gradient: action_gradient,
            ..
        } = &mut self.workspace;
        let share = 1.0 / batch.len() as f32;
        actions.clear();
        actions.extend_from_slice(self.actor.network.forward(&batch.states, threads, tape));
        let scale = self.settings.critic_scale;
        join(&batch.states, actions, scale, inputs);
        let critic = &self.critics[0].network;
        let values = critic.forward(inputs, threads, critic_tape);
        let value = values.iter().sum::<f32>() * share;
        delta.clear();
        delta.resize(batch.len(), -share);
        critic.backward(
            (inputs, delta),
            threads,
            critic_tape,
            None,
            Some(action_gradient),
        );
        delta.clear();
        for row in action_gradient.chunks_exact(self.size.inputs + ACTIONS) {
            delta.extend(
                row[self.size.inputs..]
                    .iter()
                    .zip(scale)
                    .map(|(slope, scale)| slope * scale),
            );
        }
        let preferred = batch.is_preferred.iter().sum::<f32>() + EPSILON;
        let weight = self.settings.imitation_weight / (preferred * ACTIONS as f32);
        let mut imitation = 0.0;
        for (k, (action, expert)) in actions.iter().zip(&batch.expert).enumerate() {
            let error = batch.is_preferred[k / ACTIONS] * (action - expert);
            let counts = [self.settings.imitation_steer, 1.0][k % ACTIONS];
            imitation += counts * error * error / (preferred * ACTIONS as f32);
            delta[k] += 2.0 * counts * weight * error;
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
    /// One update of the critics; every second call also updates the actor.
    pub fn update(&mut self, replay: &Replay, random: &mut impl Rng, threads: usize) -> Losses {
        replay.sample_evenly(self.size.batch, random, &mut self.workspace.batch);
        if self.workspace.batch.is_empty() {
            return Losses::default();
        }
        self.targets(random, threads);
        let critic = self.critic_loss(threads);
        self.updates += 1;
        let updates_actor = self.updates.is_multiple_of(POLICY_DELAY);
        for (critic, target) in self.critics.iter_mut().zip(&mut self.critic_targets) {
            critic.step(threads, updates_actor.then_some((target, TAU)));
        }
        if updates_actor {
            self.last_actor = self.actor_loss(threads);
            self.actor
                .step(threads, Some((&mut self.actor_target, TAU)));
        }
        Losses {
            critic,
            ..self.last_actor
        }
    }

    /// The values it keeps from its start, by configuration key.
    pub fn begun_with(&self) -> Vec<(&'static str, f64)> {
        let mut begun = self.size.begun_with(self.settings.rate);
        let weight = f64::from(self.settings.imitation_weight);
        begun.push(("learner.imitation_weight", weight));
        let noise = f64::from(self.settings.target_noise);
        begun.push(("learner.target_noise", noise));
        let steer = f64::from(self.settings.imitation_steer);
        begun.push(("learner.imitation_steer", steer));
        let [steer, pedal] = self.settings.critic_scale.map(f64::from);
        begun.push(("learner.critic_steer", steer));
        begun.push(("learner.critic_pedal", pedal));
        let is_averaged = f64::from(u8::from(self.settings.is_averaged));
        begun.push(("learner.averaged", is_averaged));
        begun
    }

    /// The present policy.
    pub fn policy(&self) -> &Network {
        match self.settings.is_averaged {
            true => &self.actor_target,
            false => &self.actor.network,
        }
    }
}

/// Each row holds a state and an action times `scale`: `batch x (inputs + ACTIONS)`.
fn join(states: &[f32], actions: &[f32], scale: [f32; ACTIONS], out: &mut Vec<f32>) {
    out.clear();
    for (state, action) in rows(states, actions).zip(actions.chunks_exact(ACTIONS)) {
        add(out, state, action, scale);
    }
}

/// The states of as many actions, one by one.
fn rows<'a>(states: &'a [f32], actions: &[f32]) -> std::slice::ChunksExact<'a, f32> {
    let count = (actions.len() / ACTIONS).max(1);
    states.chunks_exact((states.len() / count).max(1))
}

/// Adds a row of a state and an action times `scale`.
fn add(out: &mut Vec<f32>, state: &[f32], action: &[f32], scale: [f32; ACTIONS]) {
    out.extend_from_slice(state);
    out.extend(
        action
            .iter()
            .zip(scale)
            .map(|(action, scale)| action * scale),
    );
}

/// Whether the applied action is the expert's proposal. While the expert drives it is,
/// except during a hand-over, which limits the change of the command.
fn is_experts(batch: &Batch, row: usize) -> bool {
    let action = row * ACTIONS..(row + 1) * ACTIONS;
    batch.applied[action.clone()] == batch.expert[action]
}

/// Where the label prefers the expert: each state with the policy's proposal, and with
/// the expert's proposal unless the applied action, which has its own term, is that
/// proposal; and the value that each pair should have.
fn join_preferences(
    batch: &Batch,
    scale: [f32; ACTIONS],
    out: &mut Vec<f32>,
    bounds: &mut Vec<f32>,
) {
    out.clear();
    bounds.clear();
    for (k, state) in rows(&batch.states, &batch.policy).enumerate() {
        if batch.is_preferred[k] == 0.0 {
            continue;
        }
        let action = k * ACTIONS..(k + 1) * ACTIONS;
        add(out, state, &batch.policy[action.clone()], scale);
        bounds.push(-VALUE_BOUND);
        if !is_experts(batch, k) {
            add(out, state, &batch.expert[action], scale);
            bounds.push(VALUE_BOUND);
        }
    }
}

/// A normally distributed number (Box and Muller).
fn normal(random: &mut impl Rng) -> f32 {
    let radius = (-2.0 * (1.0 - random.random::<f32>()).ln()).sqrt();
    radius * (std::f32::consts::TAU * random.random::<f32>()).cos()
}

#[cfg(test)]
mod tests;
