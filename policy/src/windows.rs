//! Layers that see one part of their input after another with the same weights: circular
//! convolutions over a scan.

use crate::Refusal;
use crate::chain::{all_finite, packed as packed_layer, wrong_shape};
use crate::forward::{Activation, BLOCK, PackedLayer, relu, sums};
use crate::mlp::WIDTH_MAX;

/// A convolution: `max(0, weights w + bias)` of every window `w` of the input, behind the
/// first numbers of the input, which are passed on as they are.
#[derive(Debug, Clone, PartialEq)]
pub struct Windows {
    /// Numbers that it takes.
    pub inputs: usize,
    /// How many of its first numbers are passed on.
    pub kept: usize,
    /// Numbers in a window.
    pub window: usize,
    /// `positions` x `window`: which numbers of the input a window holds.
    pub indices: Vec<u32>,
    /// `filters` x `window`, row-major.
    pub weights: Vec<f32>,
    /// `filters`.
    pub bias: Vec<f32>,
}

impl Windows {
    /// Answers for each window.
    pub fn filters(&self) -> usize {
        self.bias.len()
    }

    /// How many windows there are.
    pub fn positions(&self) -> usize {
        self.indices.len() / self.window.max(1)
    }

    /// Numbers that it gives: those passed on, then the filters' answers, window by window.
    pub fn outputs(&self) -> usize {
        self.kept + self.positions() * self.filters()
    }

    /// Checks that sizes and indices fit each other, and that all numbers are finite.
    fn check(&self, k: usize) -> Result<(), Refusal> {
        let name = |what: &str| format!("{what} of convolution {k}");
        let is_small = |count: usize| (1..=WIDTH_MAX).contains(&count);
        let fits = is_small(self.inputs)
            && is_small(self.window)
            && is_small(self.filters())
            && is_small(self.positions())
            && self.outputs() <= WIDTH_MAX
            && self.kept <= self.inputs
            && self.indices.len() == self.positions() * self.window
            && self.weights.len() == self.filters() * self.window
            && self.indices.iter().all(|k| (*k as usize) < self.inputs);
        if !fits {
            return Err(wrong_shape(
                &name("the shape"),
                format!(
                    "{} windows of {} with {} filters over {} numbers",
                    self.positions(),
                    self.window,
                    self.filters(),
                    self.inputs
                ),
                format!("windows within the input and at most {WIDTH_MAX} answers"),
            ));
        }
        for (what, values) in [("a weight", &self.weights), ("a bias", &self.bias)] {
            if !all_finite(values) {
                return Err(Refusal::NotFinite(name(what)));
            }
        }
        Ok(())
    }
}

/// Convolutions that follow on each other, in the native runtime: the same bits on every
/// processor.
#[derive(Debug, Clone)]
pub(crate) struct Convolutions {
    layers: Vec<Windows>,
    packed: Vec<PackedLayer<Vec<[f32; BLOCK]>>>,
    /// Input and output of a layer.
    scratch: [Vec<f32>; 2],
    window: Vec<f32>,
    sums: Vec<f32>,
    arch: pulp::Arch,
}

impl Convolutions {
    /// These convolutions.
    ///
    /// # Errors
    /// When they do not follow on each other, or one is invalid.
    pub fn new(layers: Vec<Windows>) -> Result<Self, Refusal> {
        let mut packed = Vec::new();
        let mut width = layers.first().map_or(0, |layer| layer.inputs);
        for (k, layer) in layers.iter().enumerate() {
            layer.check(k)?;
            if layer.inputs != width {
                return Err(wrong_shape(
                    &format!("the input of convolution {k}"),
                    layer.inputs.to_string(),
                    width.to_string(),
                ));
            }
            width = layer.outputs();
            packed.push(packed_layer(&layer.weights, &layer.bias, Activation::None)?);
        }
        let most = |of: fn(&Windows) -> usize| layers.iter().map(of).max().unwrap_or(0);
        let widest = most(|layer| layer.inputs.max(layer.outputs()));
        let padded = packed.iter().map(PackedLayer::padded).max().unwrap_or(0);
        Ok(Self {
            scratch: [vec![0.0; widest], vec![0.0; widest]],
            window: vec![0.0; most(|layer| layer.window)],
            sums: vec![0.0; padded],
            arch: pulp::Arch::new(),
            layers,
            packed,
        })
    }

    /// The convolutions, as given.
    pub fn layers(&self) -> &[Windows] {
        &self.layers
    }

    /// The answers of the last to these inputs, which `prepare` may change first; missing ones
    /// count as 0, more are ignored. Never allocates.
    pub fn infer(&mut self, inputs: &[f32], prepare: impl FnOnce(&mut [f32])) -> &[f32] {
        let Self {
            layers,
            packed,
            scratch: [x, y],
            window,
            sums: answers,
            arch,
        } = self;
        let (width, outputs) = match &layers[..] {
            [] => (0, 0),
            [first, ..] => (first.inputs, layers[layers.len() - 1].outputs()),
        };
        let count = inputs.len().min(width);
        x[..count].copy_from_slice(&inputs[..count]);
        x[count..width].fill(0.0);
        prepare(&mut x[..width]);
        for (layer, packed) in layers.iter().zip(packed) {
            let window = &mut window[..layer.window];
            let answers = &mut answers[..packed.padded()];
            let (kept, rest) = y.split_at_mut(layer.kept);
            kept.copy_from_slice(&x[..layer.kept]);
            let places = rest.chunks_exact_mut(layer.filters());
            for (indices, place) in layer.indices.chunks_exact(layer.window).zip(places) {
                for (value, index) in window.iter_mut().zip(indices) {
                    *value = x[*index as usize];
                }
                sums(packed, window, answers, *arch);
                place.copy_from_slice(&answers[..layer.filters()]);
                relu(place);
            }
            std::mem::swap(x, y);
        }
        &x[..outputs]
    }
}

impl PartialEq for Convolutions {
    fn eq(&self, other: &Self) -> bool {
        self.layers == other.layers
    }
}
