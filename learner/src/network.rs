//! A multi-layer perceptron with its own gradients.
//!
//! Explicit forward and backward passes on a matrix library: twice as fast as
//! the autograd frameworks at these sizes, and the loss code stays a page.
//! `tests/gradients.rs` compares every gradient with finite differences.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use crate::matrix::{Old, View, product};

/// What the last layer ends with; the others end with a ReLU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Head {
    /// Nothing: a value.
    Linear,
    /// The hyperbolic tangent: an action.
    Tanh,
}

/// Sizes of one layer, and where its parameters begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Dense {
    inputs: usize,
    outputs: usize,
    /// Weights, `outputs x inputs`, rows one after the other; then the bias.
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

/// A network from a file, whose sizes may not fit together.
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

/// The activations of one pass over a batch, for the pass back.
#[derive(Clone, Debug, Default)]
pub struct Tape {
    /// Of every layer: `batch x outputs`.
    activations: Vec<Vec<f32>>,
    /// Of the layer at hand: `batch x outputs`, two by turns.
    deltas: [Vec<f32>; 2],
    batch: usize,
}

impl Network {
    /// A network with these sizes, input first, initialised as PyTorch's
    /// `Linear`: uniform within one over the root of the inputs.
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

    /// Numbers that go in.
    pub fn inputs(&self) -> usize {
        self.layers[0].inputs
    }

    /// Numbers that come out.
    pub fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs
    }

    /// What the last layer ends with.
    pub fn head(&self) -> Head {
        self.head
    }

    /// All weights and biases, layer after layer.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// All weights and biases, to be changed.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }

    /// Of each layer: inputs, outputs, weights (`outputs x inputs`), bias.
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

    /// Outputs, `batch x outputs`, of the inputs, `batch x inputs`.
    pub fn forward<'a>(&self, inputs: &[f32], threads: usize, tape: &'a mut Tape) -> &'a [f32] {
        let batch = inputs.len() / self.inputs();
        tape.batch = batch;
        tape.activations.resize_with(self.layers.len(), Vec::new);
        for (k, layer) in self.layers.iter().enumerate() {
            let (before, rest) = tape.activations.split_at_mut(k);
            let input = before.last().map_or(inputs, Vec::as_slice);
            let output = &mut rest[0];
            output.clear();
            for _ in 0..batch {
                output.extend_from_slice(&self.parameters[layer.bias()]);
            }
            let weights = View::new(
                &self.parameters[layer.weights()],
                layer.outputs,
                layer.inputs,
            );
            let input = View::new(input, batch, layer.inputs);
            product(output, Old::Add, input, weights.transposed(), threads);
            match (k + 1 == self.layers.len(), self.head) {
                (false, _) => output.iter_mut().for_each(|value| *value = value.max(0.0)),
                (true, Head::Tanh) => output.iter_mut().for_each(|value| *value = value.tanh()),
                (true, Head::Linear) => {}
            }
        }
        &tape.activations[self.layers.len() - 1]
    }

    /// The pass back: adds the gradient of the parameters to `gradient`, and
    /// writes that of the inputs, when asked for, to `input_gradient`.
    ///
    /// `delta` is the gradient of the outputs, `batch x outputs`; `tape` that of
    /// the forward pass over the same inputs.
    pub fn backward(
        &self,
        (inputs, delta): (&[f32], &[f32]),
        threads: usize,
        tape: &mut Tape,
        mut gradient: Option<&mut [f32]>,
        input_gradient: Option<&mut Vec<f32>>,
    ) {
        let batch = tape.batch;
        let [delta_here, delta_before] = &mut tape.deltas;
        delta_here.clear();
        delta_here.extend_from_slice(delta);
        let last = self.layers.len() - 1;
        for (k, layer) in self.layers.iter().enumerate().rev() {
            let output = &tape.activations[k];
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
            let input = match k {
                0 => inputs,
                _ => &tape.activations[k - 1],
            };
            let deltas = View::new(delta_here, batch, layer.outputs);
            if let Some(gradient) = gradient.as_deref_mut() {
                let input = View::new(input, batch, layer.inputs);
                let slope = &mut gradient[layer.weights()];
                product(slope, Old::Add, deltas.transposed(), input, threads);
                let bias = &mut gradient[layer.bias()];
                for row in delta_here.chunks_exact(layer.outputs) {
                    for (slope, delta) in bias.iter_mut().zip(row) {
                        *slope += delta;
                    }
                }
            }
            if k == 0 && input_gradient.is_none() {
                break;
            }
            delta_before.resize(batch * layer.inputs, 0.0);
            let weights = View::new(
                &self.parameters[layer.weights()],
                layer.outputs,
                layer.inputs,
            );
            product(delta_before, Old::Replace, deltas, weights, threads);
            std::mem::swap(delta_here, delta_before);
        }
        if let Some(input_gradient) = input_gradient {
            input_gradient.clear();
            input_gradient.extend_from_slice(delta_here);
        }
    }

    /// Moves towards another network of the same sizes by this share (Polyak).
    pub fn follow(&mut self, other: &Network, share: f32) {
        for (own, other) in self.parameters.iter_mut().zip(&other.parameters) {
            *own += share * (other - *own);
        }
    }
}
