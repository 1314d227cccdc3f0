//! A multi-layer perceptron with explicit gradients.
//!
//! Explicit forward and backward passes with a matrix library are twice as fast as the
//! autograd frameworks at these sizes, and the loss code stays short.
//! `tests/gradients.rs` compares every gradient with finite differences.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use crate::matrix::{Old, View, product};
use crate::share::share;

/// Rows of a batch that one thread processes at a time. Neither the parts nor the sums
/// over them depend on the number of threads, so the result is the same, bit by bit,
/// for any number.
pub const ROWS: usize = 128;

/// The activation of the last layer; the other layers end with a ReLU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Head {
    /// No activation: a value.
    Linear,
    /// The hyperbolic tangent: an action.
    Tanh,
}

/// The sizes of one layer, and the offset of its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Dense {
    inputs: usize,
    outputs: usize,
    /// Weights, `outputs x inputs`, row by row; then the biases.
    at: usize,
}

impl Dense {
    fn weights(self) -> std::ops::Range<usize> {
        self.at..self.at + self.outputs * self.inputs
    }

    fn bias(self) -> std::ops::Range<usize> {
        let begin = self.weights().end;
        begin..begin + self.outputs
    }
}

/// A perceptron. All parameters lie in one slice, for the optimiser and the disk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Stored")]
pub struct Network {
    layers: Vec<Dense>,
    head: Head,
    parameters: Vec<f32>,
}

/// A network read from a file, not checked yet.
#[derive(Deserialize)]
struct Stored {
    layers: Vec<Dense>,
    head: Head,
    parameters: Vec<f32>,
}

impl TryFrom<Stored> for Network {
    type Error = &'static str;

    fn try_from(stored: Stored) -> Result<Self, Self::Error> {
        let Stored {
            layers,
            head,
            parameters,
        } = stored;
        let (mut at, mut inputs) = (0_usize, layers.first().map_or(0, |layer| layer.inputs));
        for layer in &layers {
            let is_next = layer.inputs > 0 && layer.inputs == inputs && layer.at == at;
            let weights = layer.inputs.checked_mul(layer.outputs);
            let end = weights
                .and_then(|count| count.checked_add(layer.outputs)?.checked_add(at))
                .filter(|end| is_next && *end <= parameters.len());
            at = end.ok_or("layers that do not follow on each other")?;
            inputs = layer.outputs;
        }
        match at == parameters.len() && inputs > 0 {
            true => Ok(Self {
                layers,
                head,
                parameters,
            }),
            false => Err("parameters that belong to no layer"),
        }
    }
}

/// The activations of a forward pass over a batch, for the backward pass.
#[derive(Clone, Debug, Default)]
pub struct Tape {
    /// The parts of the batch; there may be more than it needs.
    parts: Vec<Part>,
    /// `batch x outputs`.
    outputs: Vec<f32>,
}

/// The activations of at most [`ROWS`] rows of a batch.
#[derive(Clone, Debug, Default)]
struct Part {
    /// The outputs of each layer, `rows x outputs`.
    activations: Vec<Vec<f32>>,
    /// The gradients of the present and the previous layer, `rows x outputs`.
    deltas: [Vec<f32>; 2],
    /// The gradient of the parameters.
    gradient: Vec<f32>,
}

impl Network {
    /// A network with these sizes, input first, initialised as PyTorch's `Linear`:
    /// uniform within one over the square root of the number of inputs.
    ///
    /// # Panics
    /// With fewer than two sizes.
    pub fn new(sizes: &[usize], head: Head, random: &mut impl Rng) -> Network {
        assert!(sizes.len() >= 2, "an input and an output at least");
        let mut layers = Vec::new();
        let mut at = 0;
        for pair in sizes.windows(2) {
            let layer = Dense {
                inputs: pair[0],
                outputs: pair[1],
                at,
            };
            at = layer.bias().end;
            layers.push(layer);
        }
        let mut parameters = vec![0.0; at];
        for layer in &layers {
            let bound = 1.0 / (layer.inputs as f32).sqrt();
            for parameter in &mut parameters[layer.at..layer.bias().end] {
                *parameter = random.random_range(-bound..bound);
            }
        }
        Network {
            layers,
            head,
            parameters,
        }
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.layers[0].inputs
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs
    }

    /// The activation of the last layer.
    pub fn head(&self) -> Head {
        self.head
    }

    /// All weights and biases, layer by layer.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// All weights and biases, mutable.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }

    /// For each layer: inputs, outputs, weights (`outputs x inputs`), biases.
    pub fn layers(&self) -> impl ExactSizeIterator<Item = (usize, usize, &[f32], &[f32])> {
        self.layers.iter().map(|layer| {
            (
                layer.inputs,
                layer.outputs,
                &self.parameters[layer.weights()],
                &self.parameters[layer.bias()],
            )
        })
    }

    /// Outputs, `batch x outputs`, of these inputs, `batch x inputs`, computed with at
    /// most this many threads.
    pub fn forward<'a>(&self, inputs: &[f32], threads: usize, tape: &'a mut Tape) -> &'a [f32] {
        let inputs = inputs.chunks(ROWS * self.inputs());
        let count = inputs.len();
        if tape.parts.len() < count {
            tape.parts.resize_with(count, Part::default);
        }
        let parts = &mut tape.parts[..count];
        share(threads, inputs.zip(&mut *parts), |(inputs, part)| {
            self.forward_rows(inputs, part);
        });
        tape.outputs.clear();
        for part in parts {
            tape.outputs
                .extend_from_slice(&part.activations[self.layers.len() - 1]);
        }
        &tape.outputs
    }

    fn forward_rows(&self, inputs: &[f32], part: &mut Part) {
        let rows = inputs.len() / self.inputs();
        part.activations.resize_with(self.layers.len(), Vec::new);
        for (k, layer) in self.layers.iter().enumerate() {
            let (before, rest) = part.activations.split_at_mut(k);
            let input = before.last().map_or(inputs, Vec::as_slice);
            let output = &mut rest[0];
            output.clear();
            for _ in 0..rows {
                output.extend_from_slice(&self.parameters[layer.bias()]);
            }
            let input = View::new(input, rows, layer.inputs);
            let weights = self.weights(layer);
            product(output, Old::Add, input, weights.transposed());
            match (k + 1 == self.layers.len(), self.head) {
                (false, _) => output.iter_mut().for_each(|value| *value = value.max(0.0)),
                (true, Head::Tanh) => output.iter_mut().for_each(|value| *value = value.tanh()),
                (true, Head::Linear) => {}
            }
        }
    }

    /// The layer's weights, `outputs x inputs`.
    fn weights(&self, layer: &Dense) -> View<'_> {
        let weights = &self.parameters[layer.weights()];
        View::new(weights, layer.outputs, layer.inputs)
    }

    /// The backward pass: adds the gradient of the parameters to `gradient`, and writes
    /// the gradient of the inputs to `input_gradient`, each if requested.
    ///
    /// `delta` is the gradient of the outputs, `batch x outputs`; `tape` is that of the
    /// forward pass over the same inputs.
    pub fn backward(
        &self,
        (inputs, delta): (&[f32], &[f32]),
        threads: usize,
        tape: &mut Tape,
        gradient: Option<&mut [f32]>,
        input_gradient: Option<&mut Vec<f32>>,
    ) {
        let inputs = inputs.chunks(ROWS * self.inputs());
        let deltas = delta.chunks(ROWS * self.outputs());
        let parts = &mut tape.parts[..inputs.len()];
        let wanted = (gradient.is_some(), input_gradient.is_some());
        let rows = inputs.zip(deltas).zip(&mut *parts);
        share(threads, rows, |(rows, part)| {
            self.backward_rows(rows, wanted, part);
        });
        if let Some(gradient) = gradient {
            for part in &*parts {
                for (slope, of_part) in gradient.iter_mut().zip(&part.gradient) {
                    *slope += of_part;
                }
            }
        }
        if let Some(input_gradient) = input_gradient {
            input_gradient.clear();
            for part in parts {
                input_gradient.extend_from_slice(&part.deltas[0]);
            }
        }
    }

    /// Writes the requested gradients, of the parameters and of the inputs, to the
    /// part's `gradient` and to the first of its `deltas`.
    fn backward_rows(
        &self,
        (inputs, delta): (&[f32], &[f32]),
        (wants_gradient, wants_input_gradient): (bool, bool),
        part: &mut Part,
    ) {
        let rows = inputs.len() / self.inputs();
        let [delta_here, delta_before] = &mut part.deltas;
        delta_here.clear();
        delta_here.extend_from_slice(delta);
        part.gradient.resize(self.parameters.len(), 0.0);
        let last = self.layers.len() - 1;
        for (k, layer) in self.layers.iter().enumerate().rev() {
            let output = &part.activations[k];
            match (k == last, self.head) {
                (true, Head::Linear) => {}
                (true, Head::Tanh) => {
                    for (delta, y) in delta_here.iter_mut().zip(output) {
                        *delta *= 1.0 - y * y;
                    }
                }
                (false, _) => {
                    for (delta, &y) in delta_here.iter_mut().zip(output) {
                        *delta = if y > 0.0 { *delta } else { 0.0 };
                    }
                }
            }
            let deltas = View::new(delta_here, rows, layer.outputs);
            if wants_gradient {
                let input = match k {
                    0 => inputs,
                    _ => &part.activations[k - 1],
                };
                let input = View::new(input, rows, layer.inputs);
                let slope = &mut part.gradient[layer.weights()];
                product(slope, Old::Replace, deltas.transposed(), input);
                let bias = &mut part.gradient[layer.bias()];
                bias.fill(0.0);
                for row in delta_here.chunks_exact(layer.outputs) {
                    for (slope, delta) in bias.iter_mut().zip(row) {
                        *slope += delta;
                    }
                }
            }
            if k == 0 && !wants_input_gradient {
                break;
            }
            delta_before.resize(rows * layer.inputs, 0.0);
            product(delta_before, Old::Replace, deltas, self.weights(layer));
            std::mem::swap(delta_here, delta_before);
        }
    }

    /// Moves the parameters towards those of another network of the same sizes by this
    /// share (Polyak averaging).
    pub fn follow(&mut self, other: &Network, share: f32) {
        for (own, other) in self.parameters.iter_mut().zip(&other.parameters) {
            *own += share * (other - *own);
        }
    }
}
