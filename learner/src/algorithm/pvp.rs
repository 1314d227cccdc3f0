//! PVP: proxy values from preferences, spread along the trajectory by temporal
//! differences without a reward, and an actor that maximises them (Sec. 4.3).
//!
//! After PVP4Real, which supplies the numbers that the paper does not give.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use super::{Learned, Losses, Size, actor};
use crate::Rate;
use crate::input::Groups;
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
    valued: StateActions,
    values: Vec<f32>,
    delta: Vec<f32>,
    gradient: Vec<f32>,
}

/// Actions of states, which the critics value.
#[derive(Clone, Debug, Default)]
struct StateActions {
    /// Times the critics' scale, state by state, `actions x ACTIONS`.
    actions: Vec<f32>,
    /// How many actions each state has.
    counts: Vec<usize>,
    /// The terms of the critics' loss, of each action; empty outside of it.
    terms: Vec<[Term; 2]>,
}

/// A term of the critics' loss: `weight (Q - target)^2`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Term {
    target: f32,
    weight: f32,
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
            valued,
            values,
            ..
        } = &mut self.workspace;
        actions.clear();
        actions.extend_from_slice(self.actor_target.forward(&batch.nexts, threads, tape));
        for action in actions.iter_mut() {
            let noise = normal(random).clamp(-TARGET_NOISE_CLIP, TARGET_NOISE_CLIP);
            *action = (*action + self.settings.target_noise * noise).clamp(-1.0, 1.0);
        }
        valued.one_each(actions, self.settings.critic_scale);
        let inputs = valued.about(&batch.nexts);
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
            critic_tape,
            valued,
            values,
            delta,
            ..
        } = &mut self.workspace;
        valued.of_loss(batch, values, self.settings.critic_scale);
        let inputs = valued.about(&batch.states);
        let share = 1.0 / batch.len() as f32;
        let mut loss = 0.0;
        for critic in &mut self.critics {
            let values = critic.network.forward(inputs, threads, critic_tape);
            delta.clear();
            for (value, terms) in values.iter().zip(&valued.terms) {
                let errors = terms.map(|term| (share * term.weight, value - term.target));
                loss += errors
                    .map(|(weight, error)| weight * error * error)
                    .iter()
                    .sum::<f32>();
                let slopes = errors.map(|(weight, error)| 2.0 * weight * error);
                delta.push(slopes.iter().sum());
            }
            let gradient = Some(&mut critic.gradient);
            let pass = (inputs, &delta[..]);
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
            valued,
            delta,
            gradient: action_gradient,
            ..
        } = &mut self.workspace;
        let share = 1.0 / batch.len() as f32;
        actions.clear();
        actions.extend_from_slice(self.actor.network.forward(&batch.states, threads, tape));
        let scale = self.settings.critic_scale;
        valued.one_each(actions, scale);
        let inputs = valued.about(&batch.states);
        let critic = &self.critics[0].network;
        let values = critic.forward(inputs, threads, critic_tape);
        let value = values.iter().sum::<f32>() * share;
        delta.clear();
        delta.resize(batch.len(), -share);
        let pass = (inputs, &delta[..]);
        critic.backward(pass, threads, critic_tape, None, Some(action_gradient));
        delta.clear();
        delta.extend(scaled(action_gradient, scale));
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
        let gradient = Some(&mut self.actor.gradient);
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
        replay.sample_evenly(self.size.batch, random, threads, &mut self.workspace.batch);
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

impl StateActions {
    /// One action of each state, `states x ACTIONS`.
    fn one_each(&mut self, actions: &[f32], scale: [f32; ACTIONS]) {
        self.actions.clear();
        self.actions.extend(scaled(actions, scale));
        self.counts.clear();
        self.counts.resize(actions.len() / ACTIONS, 1);
        self.terms.clear();
    }

    /// The actions of the critics' loss, with the targets of the applied ones. Where the label
    /// prefers the expert, the applied action is one that it prefers if it is the expert's
    /// proposal; otherwise that proposal comes separately. While the expert drives, its proposal
    /// is applied, except during a hand-over, which limits the change of the command.
    fn of_loss(&mut self, batch: &Batch, targets: &[f32], scale: [f32; ACTIONS]) {
        self.actions.clear();
        self.counts.clear();
        self.terms.clear();
        let certain = |target: f32| Term {
            target,
            weight: 1.0,
        };
        for (k, &target) in targets.iter().enumerate() {
            let own = k * ACTIONS..(k + 1) * ACTIONS;
            let [applied, policy, expert] =
                [&batch.applied, &batch.policy, &batch.expert].map(|all| &all[own.clone()]);
            let is_preferred = batch.is_preferred[k] != 0.0;
            let is_applied = is_preferred && applied == expert;
            let begin = self.terms.len();
            let mut value = |action: &[f32], terms: [Term; 2]| {
                self.actions.extend(scaled(action, scale));
                self.terms.push(terms);
            };
            let temporal_difference = Term {
                target,
                weight: batch.is_known[k],
            };
            let preference = match is_applied {
                true => certain(VALUE_BOUND),
                false => Term::default(),
            };
            value(applied, [temporal_difference, preference]);
            if is_preferred {
                value(policy, [certain(-VALUE_BOUND), Term::default()]);
            }
            if is_preferred && !is_applied {
                value(expert, [certain(VALUE_BOUND), Term::default()]);
            }
            self.counts.push(self.terms.len() - begin);
        }
    }

    /// The critics' input with these states.
    fn about<'a>(&'a self, states: &'a [f32]) -> Groups<'a> {
        Groups {
            common: states,
            own: &self.actions,
            rows: &self.counts,
        }
    }
}

/// Actions, or the gradients of such, times this.
fn scaled(actions: &[f32], scale: [f32; ACTIONS]) -> impl Iterator<Item = f32> {
    let factors = scale.into_iter().cycle();
    actions
        .iter()
        .zip(factors)
        .map(|(action, factor)| action * factor)
}

/// A normally distributed number (Box and Muller).
fn normal(random: &mut impl Rng) -> f32 {
    let radius = (-2.0 * (1.0 - random.random::<f32>()).ln()).sqrt();
    radius * (std::f32::consts::TAU * random.random::<f32>()).cos()
}

#[cfg(test)]
mod tests;
