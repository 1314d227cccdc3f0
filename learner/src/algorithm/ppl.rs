//! Predictive preference learning: where the judge prefers the expert, the
//! rejected action is followed into the future it would have led to, and the
//! expert is preferred there, too. So the policy learns to recover before it was
//! ever in danger.
//!
//! After PPL (NeurIPS 2025), with one change: it copies the intervener's action
//! to the predicted states; our expert is a program and is asked there
//! (`predictions.rs`).

use rand::Rng;
use serde::{Deserialize, Serialize};

use super::regression::Imitator;
use super::{Losses, Size};
use crate::network::Network;
use crate::replay::{ACTIONS, Replay, Ring};

/// Standard deviation of the policy seen as a normal distribution around its
/// action: with it a preference is a statement about squared distances.
const SPREAD: f32 = 0.5;
/// Sharpness of a preference, `beta` of the paper.
const SHARPNESS: f32 = 1.0;
/// Weight of the preferences beside the imitation at the same states.
const PREFERENCE_WEIGHT: f32 = 0.1;

/// An actor, taught by pairs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Ppl(Imitator);

impl Ppl {
    /// With a fresh actor.
    pub fn new(size: Size, rate: f32, random: &mut impl Rng) -> Ppl {
        Ppl(Imitator::new(size, rate, random))
    }

    /// One update: steps whose label prefers the expert, and predicted states.
    pub fn update(&mut self, replay: &Replay, random: &mut impl Rng, threads: usize) -> Losses {
        let rings = [Ring::Expert, Ring::Predicted];
        self.0.update(
            (replay, &rings),
            random,
            threads,
            |actions, batch, delta| {
                PREFERENCE_WEIGHT * prefer(actions, &batch.expert, &batch.policy, delta)
            },
        )
    }

    /// What it was begun with, by configuration key.
    pub fn begun_with(&self) -> Vec<(&'static str, f64)> {
        self.0.begun_with()
    }

    /// The policy as it is now.
    pub fn policy(&self) -> &Network {
        self.0.policy()
    }
}

/// `-log sigmoid(beta (log pi(a+) - log pi(a-)))`, the mean over the batch; its
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
    use crate::algorithm::assert_slopes;

    #[test]
    fn the_slopes_of_a_pair_are_those_of_finite_differences() {
        let mut actions = [0.3, -0.6, 0.9, 0.1, -0.2, 0.0_f32];
        let preferred = [0.1, -0.5, -0.9, 0.1, 0.2, 1.0];
        let rejected = [0.5, -0.4, 0.8, 0.3, 0.2, -1.0];
        let mut delta = vec![0.0; 6];
        prefer(&actions, &preferred, &rejected, &mut delta);
        let slopes = delta.clone();
        assert_slopes(&slopes, "the pairs", |k, by| {
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
        // As near to the one as to the other: the doubt is one half.
        assert!((loss - 2.0_f32.ln()).abs() < 1e-6, "{loss}");
        assert!(delta[0] < 0.0 && delta[1] == 0.0, "{delta:?}");
        let near = prefer(&[0.4, 0.0], &[0.5, 0.0], &[-0.5, 0.0], &mut delta);
        assert!(near < loss);
    }
}
