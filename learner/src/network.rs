//! A multi-layer perceptron with explicit gradients, with or without convolutions before it.
//!
//! Explicit forward and backward passes with a matrix library are twice as fast as the
//! autograd frameworks at these sizes, and the loss code stays short.
//! `tests/gradients.rs` compares every gradient with finite differences.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use crate::input::{Input, Workspace};
use crate::matrix::View;
use crate::share::share;
use crate::windows::{Seen, Windows};

/// Rows of a batch, or groups of rows such as a state with its actions, that one thread
/// processes at a time. Neither the parts nor the sums
/// over them depend on the number of threads, so the result is the same, bit by bit,
/// for any number.
pub const ROWS: usize = 128;

/// Parameters whose gradients one thread adds up, or with which it steps, at a time: they and
/// their moments fit into its cache.
pub(crate) const CHUNK: usize = 8192;

/// The activation of the last layer; the other layers end with a ReLU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Head {
    /// No activation: a value.
    Linear,
    /// The hyperbolic tangent: an action.
    Tanh,
}

/// The sizes of one layer, and the offset of its parameters.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Layer {
    inputs: usize,
    outputs: usize,
    /// Sums: the outputs, or the filters of a convolution.
    sums: usize,
    /// What one sum sees: the inputs, or a window of them.
    sees: usize,
    /// Weights, `sums x sees`, row by row; then the biases.
    at: usize,
    /// `None` when each sum sees the whole input.
    windows: Option<Windows>,
}

impl Layer {
    fn weights(&self) -> std::ops::Range<usize> {
        self.at..self.at + self.sums * self.sees
    }

    fn bias(&self) -> std::ops::Range<usize> {
        let begin = self.weights().end;
        begin..begin + self.sums
    }

    /// Whether the sizes fit each other.
    fn is_sound(&self) -> bool {
        self.sums > 0
            && match &self.windows {
                None => (self.inputs, self.outputs) == (self.sees, self.sums),
                Some(windows) => {
                    let answers = windows.positions().checked_mul(self.sums);
                    let outputs = answers.and_then(|count| count.checked_add(windows.kept));
                    windows.fits(self.inputs)
                        && windows.window == self.sees
                        && outputs == Some(self.outputs)
                }
            }
    }
}

/// One layer of a network, and its numbers.
#[derive(Clone, Copy, Debug)]
pub struct Weights<'a> {
    /// Numbers that it takes.
    pub inputs: usize,
    /// Numbers that it gives.
    pub outputs: usize,
    /// `outputs x inputs`; of a convolution `filters x window`.
    pub weights: &'a [f32],
    /// `outputs`; of a convolution `filters`.
    pub bias: &'a [f32],
    /// The windows of a convolution.
    pub windows: Option<&'a Windows>,
}

/// A perceptron, with or without convolutions before it. All parameters lie in one slice, for the optimiser and the disk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Stored")]
pub struct Network {
    layers: Vec<Layer>,
    head: Head,
    parameters: Vec<f32>,
}

/// A network read from a file, not checked yet.
#[derive(Deserialize)]
struct Stored {
    layers: Vec<Layer>,
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
            let weights = layer.sees.checked_mul(layer.sums);
            let end = weights
                .and_then(|count| count.checked_add(layer.sums)?.checked_add(at))
                .filter(|end| is_next && layer.is_sound() && *end <= parameters.len());
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

/// The activations of at most [`ROWS`] rows of a batch, or groups of rows.
#[derive(Clone, Debug, Default)]
struct Part {
    /// The outputs of each layer, `rows x outputs`.
    activations: Vec<Vec<f32>>,
    /// The gradients of the present and the previous layer, `rows x outputs`.
    deltas: [Vec<f32>; 2],
    /// The gradient of the parameters.
    gradient: Vec<f32>,
    /// What the convolutions have seen, by layer.
    seen: Vec<Seen>,
    workspace: Workspace,
}

impl Network {
    /// A network with these sizes, input first, initialised as PyTorch's `Linear`:
    /// uniform within one over the square root of the number of inputs.
    ///
    /// # Panics
    /// With fewer than two sizes.
    pub fn new(sizes: &[usize], head: Head, random: &mut impl Rng) -> Network {
        Network::convolved(Vec::new(), sizes, head, random)
    }

    /// The same behind these convolutions, with so many filters each. The first size is that of
    /// the input of all.
    ///
    /// # Panics
    /// With fewer than two sizes, or when the convolutions do not fit each other.
    pub fn convolved(
        convolutions: Vec<(Windows, usize)>,
        sizes: &[usize],
        head: Head,
        random: &mut impl Rng,
    ) -> Network {
        assert!(sizes.len() >= 2, "an input and an output at least");
        let mut layers: Vec<Layer> = Vec::new();
        let (mut at, mut inputs) = (0, sizes[0]);
        let dense = sizes[1..].iter().map(|outputs| (None, *outputs));
        let convolutions = convolutions.into_iter();
        let convolutions = convolutions.map(|(windows, filters)| (Some(windows), filters));
        for (windows, sums) in convolutions.chain(dense) {
            let (sees, outputs) = match &windows {
                None => (inputs, sums),
                Some(windows) => (windows.window, windows.outputs(sums)),
            };
            let layer = Layer {
                inputs,
                outputs,
                sums,
                sees,
                at,
                windows,
            };
            assert!(layer.is_sound(), "windows outside the input");
            (at, inputs) = (layer.bias().end, outputs);
            layers.push(layer);
        }
        let mut parameters = vec![0.0; at];
        for layer in &layers {
            let bound = 1.0 / (layer.sees as f32).sqrt();
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

    /// The layers, convolutions first.
    pub fn layers(&self) -> impl ExactSizeIterator<Item = Weights<'_>> {
        self.layers.iter().map(|layer| Weights {
            inputs: layer.inputs,
            outputs: layer.outputs,
            weights: &self.parameters[layer.weights()],
            bias: &self.parameters[layer.bias()],
            windows: layer.windows.as_ref(),
        })
    }

    /// Outputs, `batch x outputs`, of these inputs, computed with at most this many threads.
    ///
    /// # Panics
    /// When the input has another size, or groups of rows before a convolution.
    pub fn forward<'a, 'i>(
        &self,
        inputs: impl Into<Input<'i>>,
        threads: usize,
        tape: &'a mut Tape,
    ) -> &'a [f32] {
        let inputs = inputs.into().parts(ROWS, self.inputs());
        let count = inputs.len();
        if tape.parts.len() < count {
            tape.parts.resize_with(count, Part::default);
        }
        let parts = &mut tape.parts[..count];
        share(threads, inputs.zip(&mut *parts), |((inputs, _), part)| {
            self.forward_rows(inputs, part);
        });
        tape.outputs.clear();
        for part in parts {
            tape.outputs
                .extend_from_slice(&part.activations[self.layers.len() - 1]);
        }
        &tape.outputs
    }

    fn forward_rows(&self, inputs: Input, part: &mut Part) {
        part.activations.resize_with(self.layers.len(), Vec::new);
        part.seen.resize_with(self.layers.len(), Seen::default);
        for (k, layer) in self.layers.iter().enumerate() {
            let (before, rest) = part.activations.split_at_mut(k);
            let input = before.last().map_or(inputs, |before| Input::Rows(before));
            let output = &mut rest[0];
            if let Some(windows) = &layer.windows {
                let bias = &self.parameters[layer.bias()];
                let weights = (&self.parameters[layer.weights()], bias);
                let seen = &mut part.seen[k];
                windows.forward((input.rows(), layer.inputs), weights, seen, output);
                continue;
            }
            input.products(self.weights(layer), &mut part.workspace, output);
            let bias = &self.parameters[layer.bias()];
            match (k + 1 == self.layers.len(), self.head) {
                (false, _) => finish(output, bias, |sum| sum.max(0.0)),
                (true, Head::Tanh) => finish(output, bias, f32::tanh),
                (true, Head::Linear) => finish(output, bias, |sum| sum),
            }
        }
    }

    /// The layer's weights, `outputs x inputs`.
    fn weights(&self, layer: &Layer) -> View<'_> {
        let weights = &self.parameters[layer.weights()];
        View::new(weights, layer.outputs, layer.inputs)
    }

    /// The backward pass: writes the gradients of the parameters and of the inputs, each if
    /// requested; of groups of rows that of what each row has of its own, `rows x own`.
    ///
    /// `delta` is the gradient of the outputs, `batch x outputs`; `tape` is that of the
    /// forward pass over the same inputs.
    ///
    /// # Panics
    /// When the sizes do not fit.
    pub fn backward<'i>(
        &self,
        (inputs, delta): (impl Into<Input<'i>>, &[f32]),
        threads: usize,
        tape: &mut Tape,
        gradient: Option<&mut Vec<f32>>,
        input_gradient: Option<&mut Vec<f32>>,
    ) {
        let inputs = inputs.into().parts(ROWS, self.inputs());
        let rows = inputs.clone().next_back().map_or(0, |(_, rows)| rows.end);
        assert_eq!(
            delta.len(),
            rows * self.outputs(),
            "gradients of other rows"
        );
        let parts = &mut tape.parts[..inputs.len()];
        let wanted = (gradient.is_some(), input_gradient.is_some());
        let work = inputs.zip(&mut *parts);
        share(threads, work, |((inputs, rows), part)| {
            let delta = &delta[rows.start * self.outputs()..rows.end * self.outputs()];
            self.backward_rows((inputs, delta), wanted, part);
        });
        if let Some(gradient) = gradient {
            let parts = &*parts;
            gradient.resize(self.parameters.len(), 0.0);
            let chunks = gradient.chunks_mut(CHUNK).enumerate();
            share(threads, chunks, |(chunk, slopes)| {
                let mut of_parts = parts.iter().map(|part| &part.gradient[chunk * CHUNK..]);
                match of_parts.next() {
                    Some(first) => slopes.copy_from_slice(&first[..slopes.len()]),
                    None => slopes.fill(0.0),
                }
                of_parts.for_each(|of_part| add(slopes, of_part));
            });
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
        (inputs, delta): (Input, &[f32]),
        (wants_gradient, wants_input_gradient): (bool, bool),
        part: &mut Part,
    ) {
        let rows = delta.len() / self.outputs();
        let [delta_here, delta_before] = &mut part.deltas;
        delta_here.clear();
        delta_here.extend_from_slice(delta);
        part.gradient.resize(self.parameters.len(), 0.0);
        let last = self.layers.len() - 1;
        for (k, layer) in self.layers.iter().enumerate().rev() {
            let output = &part.activations[k];
            let wants_before = k > 0 || wants_input_gradient;
            if let Some(windows) = &layer.windows {
                let gradient = wants_gradient.then(|| {
                    let own = &mut part.gradient[layer.at..layer.bias().end];
                    own.split_at_mut(layer.weights().len())
                });
                if wants_before {
                    delta_before.resize(rows * layer.inputs, 0.0);
                }
                let before = wants_before.then_some((&mut delta_before[..], layer.inputs));
                let weights = &self.parameters[layer.weights()];
                let (pass, seen) = ((&output[..], &delta_here[..]), &mut part.seen[k]);
                windows.backward(pass, weights, seen, gradient, before);
                std::mem::swap(delta_here, delta_before);
                continue;
            }
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
                _ => Input::Rows(&part.activations[k - 1]),
            };
            if wants_gradient {
                let slopes = &mut part.gradient[layer.weights()];
                let delta = (&delta_here[..], layer.sums);
                input.slopes(delta, &mut part.workspace, slopes);
                let bias = &mut part.gradient[layer.bias()];
                bias.fill(0.0);
                let rows = delta_here.chunks_exact(layer.outputs);
                rows.for_each(|row| add(bias, row));
            }
            if !wants_before {
                break;
            }
            let deltas = View::new(delta_here, rows, layer.outputs);
            input.own_slopes(deltas, self.weights(layer), delta_before);
            std::mem::swap(delta_here, delta_before);
        }
    }
}

/// Adds a layer's biases to the products of each row, and activates the sums.
fn finish(products: &mut [f32], bias: &[f32], activate: impl Fn(f32) -> f32) {
    for row in products.chunks_exact_mut(bias.len()) {
        for (value, bias) in row.iter_mut().zip(bias) {
            *value = activate(*value + bias);
        }
    }
}

/// Adds other numbers to these.
pub(crate) fn add(sums: &mut [f32], others: &[f32]) {
    sums.iter_mut()
        .zip(others)
        .for_each(|(sum, other)| *sum += other);
}

/// Moves parameters towards those of another network by this share (Polyak averaging).
pub fn follow(parameters: &mut [f32], other: &[f32], share: f32) {
    for (own, other) in parameters.iter_mut().zip(other) {
        *own += share * (other - *own);
    }
}
