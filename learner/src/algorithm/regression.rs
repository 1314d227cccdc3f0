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

/// What a user may change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Learning rate.
    pub rate: Rate,
    /// How much more a pedal above the expert's counts than one below it. Where the expert
    /// sometimes brakes and sometimes does not, and the policy cannot tell why, it then learns
    /// to brake.
    pub excess_pedal: f32,
}

impl Settings {
    /// Eq. 1: what is above counts as much as what is below.
    pub fn even(rate: Rate) -> Settings {
        Settings {
            rate,
            excess_pedal: 1.0,
        }
    }
}

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
    pub fn new(
        source: Source,
        size: Size,
        settings: Settings,
        random: &mut impl Rng,
    ) -> Regression {
        Regression {
            imitator: Imitator::new(size, settings, random),
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
    excess_pedal: f32,
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
    pub fn new(size: Size, settings: Settings, random: &mut impl Rng) -> Imitator {
        let actor = actor(size, settings.rate, random);
        Imitator {
            average: actor.network.clone(),
            actor,
            size,
            excess_pedal: settings.excess_pedal,
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
        let imitation = imitate((actions, &batch.expert), self.excess_pedal, delta);
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
        let mut begun = self.size.begun_with(self.actor.adam.rate);
        begun.push(("learner.excess_pedal", f64::from(self.excess_pedal)));
        begun
    }

    /// The present policy.
    pub fn policy(&self) -> &Network {
        &self.average
    }
}

/// Eq. 1 with a weight for the steering and one for a pedal above the expert's: the mean over
/// the batch of the squared distance, and its gradient.
fn imitate((actions, expert): (&[f32], &[f32]), excess_pedal: f32, delta: &mut Vec<f32>) -> f32 {
    let batch = (actions.len() / ACTIONS) as f32;
    delta.clear();
    let mut loss = 0.0;
    for (k, (action, expert)) in actions.iter().zip(expert).enumerate() {
        let error = action - expert;
        let weight = match k % ACTIONS {
            0 => STEER_WEIGHT / batch,
            _ if error > 0.0 => excess_pedal / batch,
            _ => 1.0 / batch,
        };
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
        imitate((&actions, &expert), 3.0, &mut delta);
        let gradients = delta.clone();
        assert_gradients(&gradients, "the imitation", |k, by| {
            actions[k] += by;
            let loss = imitate((&actions, &expert), 3.0, &mut delta);
            actions[k] -= by;
            loss
        });
        // One row of three has an error of 1.
        for (wrong, weight) in [
            ([1.0, 0.0], STEER_WEIGHT),
            ([-1.0, 0.0], STEER_WEIGHT),
            ([0.0, 1.0], 3.0),
            ([0.0, -1.0], 1.0),
        ] {
            let actions = [wrong[0], wrong[1], 0.0, 0.0, 0.0, 0.0];
            let loss = imitate((&actions, &[0.0; 6]), 3.0, &mut delta);
            assert!((loss - weight / 3.0).abs() < 1e-6, "{wrong:?}: {loss}");
        }
    }
}
