//! Imitation: minimises the squared distance between the actor's and the expert's
//! action.

use rand::Rng;

use serde::{Deserialize, Serialize};

use super::{Learned, Losses, Size, actor};
use crate::Rate;
use crate::network::{Network, Tape};
use crate::replay::{ACTIONS, Batch, Buffer, Replay};

/// The policy averages the actors of about this many updates: single actors vary by
/// more than the distance between the car and an obstacle that it passes.
const AVERAGED: f32 = 200.0;
/// Weight of the squared steering error relative to the squared pedal error: steering
/// values are smaller, and decide whether the car crashes.
const STEER_WEIGHT: f32 = 10.0;

/// Which steps are imitated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Source {
    /// The steps at which the judge preferred the expert.
    Preferred,
    /// All steps: each records what the expert would have done.
    All,
}

/// Behaviour cloning of the expert's action.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Regression {
    imitator: Imitator,
    source: Source,
}

impl Regression {
    /// With random parameters.
    pub fn new(source: Source, size: Size, rate: Rate, random: &mut impl Rng) -> Regression {
        Regression {
            imitator: Imitator::new(size, rate, random),
            source,
        }
    }

    /// One update; does nothing when there is nothing to imitate.
    pub fn update(&mut self, replay: &Replay, random: &mut impl Rng, threads: usize) -> Losses {
        let buffers = self.buffers();
        self.imitator
            .update((replay, buffers), random, threads, |_, _, _| 0.0)
    }

    /// The replay buffers that it learns from.
    pub fn buffers(&self) -> &'static [Buffer] {
        match self.source {
            Source::Preferred => &[Buffer::Expert],
            Source::All => &Buffer::ALL,
        }
    }

    /// The values it keeps from its start, by configuration key.
    pub fn begun_with(&self) -> Vec<(&'static str, f64)> {
        self.imitator.begun_with()
    }

    /// The present policy.
    pub fn policy(&self) -> &Network {
        self.imitator.policy()
    }
}

/// An actor that imitates, and the average of its recent versions.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Imitator {
    actor: Learned,
    average: Network,
    size: Size,
    #[serde(skip)]
    workspace: Workspace,
}

#[derive(Clone, Debug, Default)]
struct Workspace {
    batch: Batch,
    tape: Tape,
    delta: Vec<f32>,
}

impl Imitator {
    /// With random parameters.
    pub fn new(size: Size, rate: Rate, random: &mut impl Rng) -> Imitator {
        let actor = actor(size, rate, random);
        Imitator {
            average: actor.network.clone(),
            actor,
            size,
            workspace: Workspace::default(),
        }
    }

    /// One update from these replay buffers. `also` adds the gradient of another loss
    /// of the actions to that of Eq. 1, and returns that loss.
    pub fn update(
        &mut self,
        (replay, buffers): (&Replay, &[Buffer]),
        random: &mut impl Rng,
        threads: usize,
        also: impl FnOnce(&[f32], &Batch, &mut [f32]) -> f32,
    ) -> Losses {
        let Workspace { batch, tape, delta } = &mut self.workspace;
        replay.sample(buffers, self.size.batch, random, threads, batch);
        if batch.is_empty() {
            return Losses::default();
        }
        let network = &self.actor.network;
        let actions = network.forward(&batch.states, threads, tape);
        let imitation = imitate(actions, &batch.expert, delta);
        let other = also(actions, batch, delta);
        let pass = (&batch.states[..], &delta[..]);
        let gradient = Some(&mut self.actor.gradient);
        network.backward(pass, threads, tape, gradient, None);
        let average = (&mut self.average, 1.0 / AVERAGED);
        self.actor.step(threads, Some(average));
        Losses {
            actor: imitation + other,
            imitation,
            critic: 0.0,
        }
    }

    /// The values it keeps from its start, by configuration key.
    pub fn begun_with(&self) -> Vec<(&'static str, f64)> {
        self.size.begun_with(self.actor.adam.rate)
    }

    /// The present policy.
    pub fn policy(&self) -> &Network {
        &self.average
    }
}

/// Eq. 1 with a weight for the steering: the mean over the batch of the squared
/// distance, and its gradient.
fn imitate(actions: &[f32], expert: &[f32], delta: &mut Vec<f32>) -> f32 {
    let batch = (actions.len() / ACTIONS) as f32;
    delta.clear();
    let mut loss = 0.0;
    for (k, (action, expert)) in actions.iter().zip(expert).enumerate() {
        let weight = match k % ACTIONS {
            0 => STEER_WEIGHT / batch,
            _ => 1.0 / batch,
        };
        let error = action - expert;
        loss += weight * error * error;
        delta.push(2.0 * weight * error);
    }
    loss
}

#[cfg(test)]
mod tests {
    use super::{STEER_WEIGHT, imitate};
    use crate::algorithm::assert_gradients;

    #[test]
    fn the_gradients_of_the_imitation_are_those_of_finite_differences() {
        let mut actions = [0.3, -0.6, 0.9, 0.1, -0.2, 0.0_f32];
        let expert = [0.1, -0.5, -0.9, 0.1, 0.2, 1.0];
        let mut delta = Vec::new();
        imitate(&actions, &expert, &mut delta);
        let gradients = delta.clone();
        assert_gradients(&gradients, "the imitation", |k, by| {
            actions[k] += by;
            let loss = imitate(&actions, &expert, &mut delta);
            actions[k] -= by;
            loss
        });
        // One row of three has an error of 1.
        let loss = imitate(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], &[0.0; 6], &mut delta);
        assert!((loss - STEER_WEIGHT / 3.0).abs() < 1e-6, "{loss}");
    }
}
