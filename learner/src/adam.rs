//! Adam, as in PyTorch: Kingma and Ba, 2015, Algorithm 1.

use serde::{Deserialize, Serialize};

/// Exponential decay of the first moment.
const BETA_1: f64 = 0.9;
/// Exponential decay of the second moment.
const BETA_2: f64 = 0.999;
/// Epsilon: keeps the division finite.
const EPSILON: f32 = 1e-8;

/// The optimiser of one network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Adam {
    /// Learning rate.
    pub rate: f32,
    first: Vec<f32>,
    second: Vec<f32>,
    steps: u64,
}

impl Adam {
    /// An optimiser for this many parameters.
    pub fn new(parameters: usize, rate: f32) -> Adam {
        Adam {
            rate,
            first: vec![0.0; parameters],
            second: vec![0.0; parameters],
            steps: 0,
        }
    }

    /// One step against the gradient.
    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f32]) {
        self.steps += 1;
        let steps = i32::try_from(self.steps).unwrap_or(i32::MAX);
        let first_share = 1.0 - BETA_1.powi(steps);
        let second_share = 1.0 - BETA_2.powi(steps);
        let rate = self.rate * (1.0 / first_share) as f32;
        let root = (1.0 / second_share.sqrt()) as f32;
        let (beta_1, beta_2) = (BETA_1 as f32, BETA_2 as f32);
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((parameter, &slope), (first, second)) in
            parameters.iter_mut().zip(gradient).zip(moments)
        {
            *first = beta_1 * *first + (1.0 - beta_1) * slope;
            *second = beta_2 * *second + (1.0 - beta_2) * slope * slope;
            *parameter -= rate * *first / (second.sqrt() * root + EPSILON);
        }
    }
}
