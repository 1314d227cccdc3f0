use shm_config::message::{FEATURES, INPUTS_WITH_MOTION};

use crate::Refusal;
use crate::chain::{Chain, Shape, wrong_shape};
use crate::forward::{ACTIONS, Activation, Compression, policy_inputs};
use crate::windows::{Convolutions, Windows};

/// `y = activation(weights x + bias)`.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// `outputs` x `inputs`, row-major, as PyTorch's `Linear.weight`.
    pub weights: Vec<f32>,
    /// `outputs`.
    pub bias: Vec<f32>,
    /// Length of `x`.
    pub inputs: usize,
    /// Length of `y`.
    pub outputs: usize,
    /// What follows the sums.
    pub activation: Activation,
}

/// Widest layer: two such layers would already be over the size of a file.
pub const WIDTH_MAX: usize = 1 << 14;

/// The native runtime: a multilayer perceptron from the 259 features of an observation, or
/// from these and the 120 of how bodies move, to 2 actions; with or without convolutions
/// before it.
///
/// Every sum is taken in the order of the inputs, one product and one addition
/// at a time and without fused operations, so that a net answers the same bits
/// on every processor, for any width of its vectors, as long as its activations
/// do (`tanh` is the C library's).
#[derive(Debug, Clone, PartialEq)]
pub struct Mlp {
    compression: Compression,
    convolutions: Convolutions,
    chain: Chain,
}

impl Mlp {
    /// What a policy takes and gives whose first layer takes so many numbers: those of the
    /// observation alone, unless it is as many as with motion.
    pub const fn shape(inputs: usize) -> Shape {
        Shape {
            inputs: policy_inputs(inputs),
            outputs: ACTIONS,
        }
    }

    /// A net of these layers.
    ///
    /// # Errors
    /// When the layers do not follow on each other, do not take
    /// [`FEATURES`] or [`INPUTS_WITH_MOTION`] or answer [`ACTIONS`] numbers, are too many or too wide, or
    /// hold a number that is not finite.
    pub fn new(layers: Vec<Layer>) -> Result<Mlp, Refusal> {
        Mlp::compressed(Compression::default(), layers)
    }

    /// A net of these layers behind this compression of its features. One that changes none
    /// of them is the same as none.
    ///
    /// # Errors
    /// As [`Mlp::new`], or when the slope is negative or not finite.
    pub fn compressed(compression: Compression, layers: Vec<Layer>) -> Result<Mlp, Refusal> {
        Mlp::convolved(compression, Vec::new(), layers)
    }

    /// A net of these convolutions and layers behind this compression of its features.
    ///
    /// # Errors
    /// As [`Mlp::compressed`], or when a convolution is invalid.
    pub fn convolved(
        compression: Compression,
        convolutions: Vec<Windows>,
        layers: Vec<Layer>,
    ) -> Result<Mlp, Refusal> {
        let slope = compression.slope;
        if !(slope.is_finite() && slope >= 0.0) {
            let expected = "a number of at least 0".into();
            return Err(wrong_shape(
                "the slope of the compression",
                slope.to_string(),
                expected,
            ));
        }
        let first = layers.first().map(|layer| layer.inputs);
        let first = convolutions.first().map(|layer| layer.inputs).or(first);
        let shape = Self::shape(first.unwrap_or(FEATURES));
        let convolutions = Convolutions::new(convolutions)?;
        let seen = convolutions.layers();
        if let Some(layer) = seen.first().filter(|layer| layer.inputs != shape.inputs) {
            return Err(wrong_shape(
                "the input of convolution 0",
                layer.inputs.to_string(),
                shape.inputs.to_string(),
            ));
        }
        let inputs = seen.last().map_or(shape.inputs, Windows::outputs);
        let chain = Chain::new(layers, Shape { inputs, ..shape })?;
        let to = compression.to.min(shape.inputs);
        let compression = match slope == 0.0 || compression.from >= to {
            true => Compression::default(),
            false => Compression { to, ..compression },
        };
        Ok(Mlp {
            compression,
            convolutions,
            chain,
        })
    }

    /// What the features go through before the first layer.
    pub fn compression(&self) -> Compression {
        self.compression
    }

    /// How many numbers it takes: [`FEATURES`] or [`INPUTS_WITH_MOTION`].
    pub fn inputs(&self) -> usize {
        let first = self.layers().first().map(|layer| layer.inputs);
        let convolution = self.convolutions().first().map(|layer| layer.inputs);
        convolution.or(first).unwrap_or(FEATURES)
    }

    /// Whether it takes how bodies move.
    pub fn takes_motion(&self) -> bool {
        self.inputs() == INPUTS_WITH_MOTION
    }

    /// The convolutions before the layers, as given.
    pub fn convolutions(&self) -> &[Windows] {
        self.convolutions.layers()
    }

    /// The layers, as given.
    pub fn layers(&self) -> &[Layer] {
        self.chain.layers()
    }

    /// The answer to the features: steering and pedal, normalised, as the
    /// net has them: neither clamped nor checked. Missing features count as 0,
    /// more are ignored. Never allocates.
    pub fn infer(&mut self, features: &[f32]) -> [f32; ACTIONS] {
        let Self {
            compression,
            convolutions,
            chain,
        } = self;
        let answer = match convolutions.layers() {
            [] => chain.infer_compressed(features, *compression),
            [_, ..] => chain.infer(convolutions.infer(features, |x| compression.apply(x))),
        };
        match *answer {
            [steer, pedal, ..] => [steer, pedal],
            // `new` has checked that there are two.
            _ => [f32::NAN; ACTIONS],
        }
    }
}
