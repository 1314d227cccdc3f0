use shm_config::message::FEATURES;

use crate::Refusal;

/// What follows a layer's sums.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    None,
    /// `max(0, x)`.
    Relu,
    /// `tanh(x)`.
    Tanh,
}

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

/// Numbers that the policy answers with: steering and pedal, normalised.
pub const ACTIONS: usize = 2;
/// Most layers of a net.
pub const LAYERS_MAX: usize = 16;
/// Widest layer: two such layers would already be over the size of a file.
pub const WIDTH_MAX: usize = 1 << 14;
/// Outputs whose sums are kept in registers together: four registers of AVX-512,
/// eight of AVX2, and sixteen of SSE2, half of which then live in the cache.
const BLOCK: usize = 64;

/// The native runtime: a multilayer perceptron from 259 features to 2 actions.
///
/// Every sum is taken in the order of the inputs, one product and one addition
/// at a time and without fused operations, so that a net answers the same bits
/// on every processor, whatever its vectors' width, as long as its activations
/// do (`tanh` is the C library's).
#[derive(Debug, Clone)]
pub struct Mlp {
    layers: Vec<Layer>,
    packed: Vec<Packed>,
    /// The layer's input, padded, and its output.
    scratch: [Vec<f32>; 2],
    arch: pulp::Arch,
}

/// A layer as the inner loop reads it: blocks of [`BLOCK`] outputs, in each
/// first the bias, then for each input the weights of the block's outputs; with
/// zeros behind the last output.
#[derive(Debug, Clone)]
struct Packed {
    blocks: Vec<[f32; BLOCK]>,
    inputs: usize,
    outputs: usize,
    activation: Activation,
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
        let packed: Vec<_> = layers.iter().map(Packed::new).collect();
        let width = packed.iter().map(|layer| layer.width().max(layer.inputs));
        let width = width.max().unwrap_or(0);
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
    /// more are not looked at. Never allocates.
    pub fn infer(&mut self, features: &[f32]) -> [f32; ACTIONS] {
        let [x, y] = &mut self.scratch;
        let count = features.len().min(FEATURES);
        x[..count].copy_from_slice(&features[..count]);
        x[count..FEATURES].fill(0.0);
        for layer in &self.packed {
            self.arch.dispatch(Product {
                layer,
                x: &x[..layer.inputs],
                y: &mut y[..layer.width()],
            });
            layer.activate(&mut y[..layer.outputs]);
            std::mem::swap(x, y);
        }
        [x[0], x[1]]
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

impl Packed {
    fn new(layer: &Layer) -> Packed {
        let (inputs, outputs) = (layer.inputs, layer.outputs);
        let count = outputs.div_ceil(BLOCK);
        let mut blocks = vec![[0.0; BLOCK]; count * (1 + inputs)];
        for output in 0..outputs {
            let (block, lane) = (output / BLOCK, output % BLOCK);
            let block = &mut blocks[block * (1 + inputs)..][..1 + inputs];
            block[0][lane] = layer.bias[output];
            let row = &layer.weights[output * inputs..][..inputs];
            for (place, &weight) in block[1..].iter_mut().zip(row) {
                place[lane] = weight;
            }
        }
        Packed {
            blocks,
            inputs,
            outputs,
            activation: layer.activation,
        }
    }

    /// Outputs with the zeros behind them.
    fn width(&self) -> usize {
        self.outputs.div_ceil(BLOCK) * BLOCK
    }

    fn activate(&self, y: &mut [f32]) {
        match self.activation {
            Activation::None => {}
            // `max` would turn NaN into 0 and hide it.
            Activation::Relu => y
                .iter_mut()
                .for_each(|y| *y = if *y < 0.0 { 0.0 } else { *y }),
            Activation::Tanh => y.iter_mut().for_each(|y| *y = y.tanh()),
        }
    }
}

/// One layer's sums, compiled for each width of vectors and chosen at run time.
struct Product<'a> {
    layer: &'a Packed,
    x: &'a [f32],
    y: &'a mut [f32],
}

impl pulp::NullaryFnOnce for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let rows = 1 + self.layer.inputs;
        let blocks = self.layer.blocks.chunks_exact(rows);
        for (block, y) in blocks.zip(self.y.chunks_exact_mut(BLOCK)) {
            let Some((bias, weights)) = block.split_first() else {
                return;
            };
            let mut sums = *bias;
            for (weights, &x) in weights.iter().zip(self.x) {
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    *sum += weight * x;
                }
            }
            y.copy_from_slice(&sums);
        }
    }
}
