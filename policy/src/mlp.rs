use shm_config::message::FEATURES;

use crate::Refusal;
use crate::forward::{ACTIONS, Activation, BLOCK, LAYERS_MAX, PackedLayer, forward, pack};

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

/// The native runtime: a multilayer perceptron from 259 features to 2 actions.
///
/// Every sum is taken in the order of the inputs, one product and one addition
/// at a time and without fused operations, so that a net answers the same bits
/// on every processor, for any width of its vectors, as long as its activations
/// do (`tanh` is the C library's).
#[derive(Debug, Clone)]
pub struct Mlp {
    layers: Vec<Layer>,
    packed: Vec<PackedLayer<Vec<[f32; BLOCK]>>>,
    /// The layer's input, padded, and its output.
    scratch: [Vec<f32>; 2],
    arch: pulp::Arch,
}

impl Mlp {
    /// A net of these layers.
    ///
    /// # Errors
    /// When the layers do not follow on each other, do not take
    /// [`FEATURES`] or answer [`ACTIONS`] numbers, are too many or too wide, or
    /// hold a number that is not finite.
    pub fn new(layers: Vec<Layer>) -> Result<Mlp, Refusal> {
        check(&layers)?;
        let packed: Vec<_> = layers.iter().map(packed).collect::<Result<_, _>>()?;
        let width = packed.iter().map(PackedLayer::row).max().unwrap_or(0);
        Ok(Mlp {
            layers,
            packed,
            scratch: [vec![0.0; width], vec![0.0; width]],
            arch: pulp::Arch::new(),
        })
    }

    /// The layers, as given.
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// The answer to [`FEATURES`] features: steering and pedal, normalised, as the
    /// net has them: neither clamped nor checked. Missing features count as 0,
    /// more are ignored. Never allocates.
    pub fn infer(&mut self, features: &[f32]) -> [f32; ACTIONS] {
        let [x, y] = &mut self.scratch;
        forward(&self.packed, [x, y], features, self.arch)
    }
}

impl PartialEq for Mlp {
    fn eq(&self, other: &Mlp) -> bool {
        self.layers == other.layers
    }
}

fn check(layers: &[Layer]) -> Result<(), Refusal> {
    if layers.is_empty() || layers.len() > LAYERS_MAX {
        return Err(wrong_shape(
            "the net",
            format!("{} layers", layers.len()),
            format!("1 to {LAYERS_MAX}"),
        ));
    }
    let mut width = FEATURES;
    for (k, layer) in layers.iter().enumerate() {
        let name = |what: &str| format!("{what} of layer {k}");
        let dimensions = |what, found: usize, expected: usize| match found == expected {
            true => Ok(()),
            false => Err(wrong_shape(
                &name(what),
                found.to_string(),
                expected.to_string(),
            )),
        };
        dimensions("the input", layer.inputs, width)?;
        if layer.outputs == 0 || layer.outputs > WIDTH_MAX {
            return Err(wrong_shape(
                &name("the output"),
                layer.outputs.to_string(),
                format!("1 to {WIDTH_MAX}"),
            ));
        }
        // Both factors are limited, so the product is a number.
        dimensions(
            "the weights",
            layer.weights.len(),
            layer.inputs * layer.outputs,
        )?;
        dimensions("the bias", layer.bias.len(), layer.outputs)?;
        for (what, values) in [("a weight", &layer.weights), ("a bias", &layer.bias)] {
            if !all_finite(values) {
                return Err(Refusal::NotFinite(name(what)));
            }
        }
        width = layer.outputs;
    }
    match width {
        ACTIONS => Ok(()),
        width => Err(wrong_shape(
            "the output",
            width.to_string(),
            format!("{ACTIONS}: steering and pedal"),
        )),
    }
}

/// No value is NaN or infinite.
pub(crate) fn all_finite(values: &[f32]) -> bool {
    values.iter().all(|value| value.is_finite())
}

pub(crate) fn wrong_shape(what: &str, found: String, expected: String) -> Refusal {
    Refusal::WrongShape {
        what: what.into(),
        found,
        expected,
    }
}

fn packed(layer: &Layer) -> Result<PackedLayer<Vec<[f32; BLOCK]>>, Refusal> {
    let shape = [layer.inputs, layer.outputs];
    let count = PackedLayer::<()>::block_count(layer.inputs, layer.outputs);
    let mut blocks = vec![[0.0; BLOCK]; count];
    pack(&layer.weights, &layer.bias, &mut blocks)
        .and_then(|()| PackedLayer::packed(blocks, shape, layer.activation))
        .map_err(|mismatch| Refusal::Graph(mismatch.to_string()))
}
