//! Imitation: the actor's squared distance to the expert's action.

use rand::Rng;

use super::{Algorithm, Learned, Losses, Size, actor};
use crate::network::{Network, Tape};
use crate::replay::{ACTIONS, Batch, Replay, Ring};

/// Which steps are imitated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Those at which the judge preferred the expert.
    Preferred,
    /// All: every step records what the expert would have done.
    All,
}

/// Behaviour cloning on one ring or both.
pub struct Regression {
    actor: Learned,
    source: Source,
    size: Size,
    batch: Batch,
    tape: Tape,
    delta: Vec<f32>,
}

impl Regression {
    /// With a fresh actor.
    pub fn new(source: Source, size: Size, rate: f32, random: &mut impl Rng) -> Regression {
        Regression {
            actor: actor(size, rate, random),
            source,
            size,
            batch: Batch::default(),
            tape: Tape::default(),
            delta: Vec::new(),
        }
    }
}

impl Algorithm for Regression {
    fn update(&mut self, replay: &Replay, mut random: &mut dyn Rng) -> Losses {
        let rings: &[Ring] = match self.source {
            Source::Preferred => &[Ring::Expert],
            Source::All => &Ring::ALL,
        };
        replay.sample(rings, self.size.batch, &mut random, &mut self.batch);
        if self.batch.is_empty() {
            return Losses::default();
        }
        let threads = self.size.threads;
        let network = &self.actor.network;
        let actions = network.forward(&self.batch.states, threads, &mut self.tape);
        let imitation = imitate(actions, &self.batch.expert, &mut self.delta);
        let pass = (&self.batch.states[..], &self.delta[..]);
        let gradient = Some(&mut self.actor.gradient[..]);
        network.backward(pass, threads, &mut self.tape, gradient, None);
        self.actor.step();
        Losses {
            actor: imitation,
            imitation,
            critic: 0.0,
        }
    }

    fn policy(&self) -> &Network {
        &self.actor.network
    }

    fn parts(&mut self) -> Vec<&mut Learned> {
        vec![&mut self.actor]
    }
}

/// Eq. 1: the mean over the batch of the squared distance, and its gradient.
fn imitate(actions: &[f32], expert: &[f32], delta: &mut Vec<f32>) -> f32 {
    let batch = (actions.len() / ACTIONS) as f32;
    delta.clear();
    let mut loss = 0.0;
    for (action, expert) in actions.iter().zip(expert) {
        let error = action - expert;
        loss += error * error / batch;
        delta.push(2.0 * error / batch);
    }
    loss
}
