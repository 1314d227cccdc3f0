//! Small networks of random weights: another driver for each seed, for rehearsed runs and
//! tests.

use shm_config::draw::Draw;
use shm_config::message::FEATURES;

use crate::{ACTIONS, Activation, Layer, Mlp, Refusal};

/// Neurons of the hidden layer.
const HIDDEN: usize = 8;

/// How the numbers of a drawn network are spread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Largest weight of each layer.
    pub weights: [f64; 2],
    /// Smallest bias.
    pub bias_min: f64,
    /// Largest bias.
    pub bias_max: f64,
}

/// The network of a seed: 259-8-2, tanh.
///
/// # Errors
/// When a number is not finite.
pub fn net(seed: u64, spread: Spread) -> Result<Mlp, Refusal> {
    let mut draw = Draw::new(seed);
    let mut layer = |inputs: usize, outputs: usize, most: f64| Layer {
        weights: (0..inputs * outputs)
            .map(|_| draw.within(-most, most) as f32)
            .collect(),
        bias: (0..outputs)
            .map(|_| draw.within(spread.bias_min, spread.bias_max) as f32)
            .collect(),
        inputs,
        outputs,
        activation: Activation::Tanh,
    };
    let [see, act] = spread.weights;
    Mlp::new(vec![
        layer(FEATURES, HIDDEN, see),
        layer(HIDDEN, ACTIONS, act),
    ])
}
