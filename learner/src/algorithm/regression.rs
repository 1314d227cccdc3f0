//! Imitation: the actor's squared distance to the expert's action.

use rand::Rng;

use serde::{Deserialize, Serialize};

use super::{Learned, Losses, Size, actor};
use crate::network::{Network, Tape};
use crate::replay::{ACTIONS, Batch, Replay, Ring};

/// The policy is the average of the actors of about this many updates: single
/// ones wobble by more than the car has room beside an obstacle.
const AVERAGED: f32 = 200.0;
/// An error of the steering counts as much as one of the pedal this many times
/// as large squared: steering is smaller, and what a crash depends on.
const STEER_WEIGHT: f32 = 10.0;

/// Which steps are imitated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Source {
    /// Those at which the judge preferred the expert.
    Preferred,
    /// All: every step records what the expert would have done.
    All,
}

/// Behaviour cloning of what the expert would have done.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Regression {
    imitator: Imitator,
    source: Source,
}

impl Regression {
    /// With a fresh actor.
    pub fn new(source: Source, size: Size, rate: f32, random: &mut impl Rng) -> Regression {
        Regression {
            imitator: Imitator::new(size, rate, random),
            source,
        }
    }

    /// One update; none when there is nothing to imitate.
    pub fn update(&mut self, replay: &Replay, random: &mut impl Rng, threads: usize) -> Losses {
        let rings: &[Ring] = match self.source {
            Source::Preferred => &[Ring::Expert],
            Source::All => &Ring::ALL,
        };
        self.imitator
            .update((replay, rings), random, threads, |_, _, _| 0.0)
    }

    /// What it was begun with, by configuration key.
    pub fn begun_with(&self) -> Vec<(&'static str, f64)> {
        self.imitator.begun_with()
    }

    /// The policy as it is now.
    pub fn policy(&self) -> &Network {
        self.imitator.policy()
    }
}

/// An actor that imitates, and its average.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Imitator {
    actor: Learned,
    average: Network,
    size: Size,
    #[serde(skip)]
    room: Room,
}

#[derive(Clone, Debug, Default)]
struct Room {
    batch: Batch,
    tape: Tape,
    delta: Vec<f32>,
}

impl Imitator {
    /// With a fresh actor.
    pub fn new(size: Size, rate: f32, random: &mut impl Rng) -> Imitator {
        let actor = actor(size, rate, random);
        Imitator {
            average: actor.network.clone(),
            actor,
            size,
            room: Room::default(),
        }
    }

    /// One update from these rings; `also` adds the gradient of another loss of
    /// the actions to that of Eq. 1, and returns it.
    pub fn update(
        &mut self,
        (replay, rings): (&Replay, &[Ring]),
        random: &mut impl Rng,
        threads: usize,
        also: impl FnOnce(&[f32], &Batch, &mut [f32]) -> f32,
    ) -> Losses {
        let Room { batch, tape, delta } = &mut self.room;
        replay.sample(rings, self.size.batch, random, batch);
        if batch.is_empty() {
            return Losses::default();
        }
        let network = &self.actor.network;
        let actions = network.forward(&batch.states, threads, tape);
        let imitation = imitate(actions, &batch.expert, delta);
        let other = also(actions, batch, delta);
        let pass = (&batch.states[..], &delta[..]);
        let gradient = Some(&mut self.actor.gradient[..]);
        network.backward(pass, threads, tape, gradient, None);
        self.actor.step();
        self.average.follow(&self.actor.network, 1.0 / AVERAGED);
        Losses {
            actor: imitation + other,
            imitation,
            critic: 0.0,
        }
    }

    /// What it was begun with, by configuration key.
    pub fn begun_with(&self) -> Vec<(&'static str, f64)> {
        self.size.begun_with(self.actor.adam.rate)
    }

    /// The policy as it is now.
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
    use crate::algorithm::assert_slopes;

    #[test]
    fn the_slopes_of_the_imitation_are_those_of_finite_differences() {
        let mut actions = [0.3, -0.6, 0.9, 0.1, -0.2, 0.0_f32];
        let expert = [0.1, -0.5, -0.9, 0.1, 0.2, 1.0];
        let mut delta = Vec::new();
        imitate(&actions, &expert, &mut delta);
        let slopes = delta.clone();
        assert_slopes(&slopes, "the imitation", |k, by| {
            actions[k] += by;
            let loss = imitate(&actions, &expert, &mut delta);
            actions[k] -= by;
            loss
        });
        // One error of 1 in one of three rows.
        let loss = imitate(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], &[0.0; 6], &mut delta);
        assert!((loss - STEER_WEIGHT / 3.0).abs() < 1e-6, "{loss}");
    }
}
