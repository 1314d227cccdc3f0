//! Predictive preference learning: where the judge prefers the expert, a rollout of the
//! rejected action gives predicted states, at which the expert is preferred too. So the
//! policy learns to recover before it is in danger.
//!
//! After PPL (NeurIPS 2025), with one change: PPL copies the intervener's action to the
//! predicted states; here the expert is a program and is asked at each of them
//! (`learner/src/imagine.rs`).

use rand::Rng;
use serde::{Deserialize, Serialize};

use super::regression::{Imitator, Settings};
use super::{Losses, Size};
use crate::network::Network;
use crate::replay::{ACTIONS, Buffer, Replay};

/// Standard deviation of a normal distribution around the policy's action. With it, a
/// preference becomes a statement about squared distances.
const SPREAD: f32 = 0.5;
/// Sharpness of a preference, `beta` of the paper.
const SHARPNESS: f32 = 1.0;
/// Weight of the preference loss relative to the imitation loss at the same states.
const PREFERENCE_WEIGHT: f32 = 0.1;

/// An actor that learns from pairs of actions.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Ppl(Imitator);

impl Ppl {
    /// With random parameters.
    pub fn new(size: Size, settings: Settings, random: &mut impl Rng) -> Ppl {
        Ppl(Imitator::new(size, settings, random))
    }

    /// One update from the steps whose label prefers the expert, and from predicted
    /// states.
    pub fn update(&mut self, replay: &Replay, random: &mut impl Rng, threads: usize) -> Losses {
        let buffers = self.buffers();
        self.0.update(
            (replay, buffers),
            random,
            threads,
            |actions, batch, delta| {
                PREFERENCE_WEIGHT * prefer(actions, &batch.expert, &batch.policy, delta)
            },
        )
    }

    /// The replay buffers that it learns from.
    pub fn buffers(&self) -> &'static [Buffer] {
        &[Buffer::Expert, Buffer::Predicted]
    }

    /// The values it keeps from its start, by configuration key.
    pub fn begun_with(&self) -> Vec<(&'static str, f64)> {
        self.0.begun_with()
    }

    /// The present policy.
    pub fn policy(&self) -> &Network {
        self.0.policy()
    }
}

/// The mean over the batch of `-log sigmoid(beta (log pi(a+) - log pi(a-)))`; its
/// weighted gradient is added to `delta`.
fn prefer(actions: &[f32], preferred: &[f32], rejected: &[f32], delta: &mut [f32]) -> f32 {
    let batch = (actions.len() / ACTIONS) as f32;
    let scale = SHARPNESS / (2.0 * SPREAD * SPREAD);
    let mut loss = 0.0;
    let rows = actions
        .chunks_exact(ACTIONS)
        .zip(preferred.chunks_exact(ACTIONS))
        .zip(rejected.chunks_exact(ACTIONS))
        .zip(delta.chunks_exact_mut(ACTIONS));
    for (((action, preferred), rejected), delta) in rows {
        let square = |other: &[f32]| -> f32 {
            let pairs = action.iter().zip(other);
            pairs.map(|(a, b)| (a - b) * (a - b)).sum()
        };
        let margin = scale * (square(rejected) - square(preferred));
        loss += (-margin).exp().ln_1p() / batch;
        let doubt = 1.0 / (1.0 + margin.exp());
        let weight = PREFERENCE_WEIGHT * doubt * 2.0 * scale / batch;
        for (delta, (preferred, rejected)) in delta.iter_mut().zip(preferred.iter().zip(rejected)) {
            *delta += weight * (rejected - preferred);
        }
    }
    loss
}

#[cfg(test)]
mod tests {
    use super::{PREFERENCE_WEIGHT, prefer};
    use crate::algorithm::assert_gradients;

    #[test]
    fn the_gradients_of_a_pair_equal_finite_differences() {
        let mut actions = [0.3, -0.6, 0.9, 0.1, -0.2, 0.0_f32];
        let preferred = [0.1, -0.5, -0.9, 0.1, 0.2, 1.0];
        let rejected = [0.5, -0.4, 0.8, 0.3, 0.2, -1.0];
        let mut delta = vec![0.0; 6];
        prefer(&actions, &preferred, &rejected, &mut delta);
        let gradients = delta.clone();
        assert_gradients(&gradients, "the pairs", |k, by| {
            actions[k] += by;
            let loss = prefer(&actions, &preferred, &rejected, &mut delta);
            actions[k] -= by;
            PREFERENCE_WEIGHT * loss
        });
    }

    #[test]
    fn a_pair_pulls_from_the_rejected_to_the_preferred_action() {
        let mut delta = vec![0.0; 2];
        let loss = prefer(&[0.0, 0.0], &[0.5, 0.0], &[-0.5, 0.0], &mut delta);
        // At equal distances from both actions the probability is one half.
        assert!((loss - 2.0_f32.ln()).abs() < 1e-6, "{loss}");
        assert!(delta[0] < 0.0 && delta[1] == 0.0, "{delta:?}");
        let near = prefer(&[0.4, 0.0], &[0.5, 0.0], &[-0.5, 0.0], &mut delta);
        assert!(near < loss);
    }
}
