//! A chain of layers of any shape, and its native runtime.

use crate::Refusal;
use crate::forward::{Activation, BLOCK, Compression, LAYERS_MAX, PackedLayer, forward, pack};
use crate::mlp::{Layer, WIDTH_MAX};

/// How many numbers a net takes and gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// Numbers that it takes.
    pub inputs: usize,
    /// Numbers that it gives.
    pub outputs: usize,
}

/// The native runtime of a chain of layers: the same bits on every processor, as those
/// of [`crate::Mlp`].
#[derive(Debug, Clone)]
pub struct Chain {
    layers: Vec<Layer>,
    packed: Vec<PackedLayer<Vec<[f32; BLOCK]>>>,
    /// The layer's input, padded, and its output.
    scratch: [Vec<f32>; 2],
    arch: pulp::Arch,
}

impl Chain {
    /// A net of these layers.
    ///
    /// # Errors
    /// When the layers do not follow on each other, do not have this shape, are too many
    /// or too wide, or hold a number that is not finite.
    pub fn new(layers: Vec<Layer>, shape: Shape) -> Result<Chain, Refusal> {
        check(&layers, shape)?;
        let packed = layers
            .iter()
            .map(|layer| packed(&layer.weights, &layer.bias, layer.activation))
            .collect::<Result<Vec<_>, _>>()?;
        let width = packed.iter().map(PackedLayer::row).max().unwrap_or(0);
        Ok(Chain {
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

    /// The answer of the net. Missing inputs count as 0, more are ignored. Never
    /// allocates.
    pub fn infer(&mut self, inputs: &[f32]) -> &[f32] {
        self.infer_compressed(inputs, Compression::default())
    }

    /// [`Chain::infer`] behind this compression of the inputs.
    pub(crate) fn infer_compressed(&mut self, inputs: &[f32], by: Compression) -> &[f32] {
        let [x, y] = &mut self.scratch;
        forward(&self.packed, [x, y], (inputs, by), self.arch)
    }
}

impl PartialEq for Chain {
    fn eq(&self, other: &Chain) -> bool {
        self.layers == other.layers
    }
}

fn check(layers: &[Layer], shape: Shape) -> Result<(), Refusal> {
    if layers.is_empty() || layers.len() > LAYERS_MAX {
        return Err(wrong_shape(
            "the net",
            format!("{} layers", layers.len()),
            format!("1 to {LAYERS_MAX}"),
        ));
    }
    let mut width = shape.inputs;
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
    match width == shape.outputs {
        true => Ok(()),
        false => Err(wrong_shape(
            "the output",
            width.to_string(),
            shape.outputs.to_string(),
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

/// Weights (`outputs` x `inputs`) and bias as the inner loop reads them.
pub(crate) fn packed(
    weights: &[f32],
    bias: &[f32],
    activation: Activation,
) -> Result<PackedLayer<Vec<[f32; BLOCK]>>, Refusal> {
    let shape = [weights.len() / bias.len().max(1), bias.len()];
    let count = PackedLayer::<()>::block_count(shape[0], shape[1]);
    let mut blocks = vec![[0.0; BLOCK]; count];
    pack(weights, bias, &mut blocks)
        .and_then(|()| PackedLayer::packed(blocks, shape, activation))
        .map_err(|mismatch| Refusal::Graph(mismatch.to_string()))
}
