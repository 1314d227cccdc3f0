//! A layer that answers each window of its input with the same weights: a circular
//! convolution over a scan.

use serde::{Deserialize, Serialize};

use crate::matrix::{Old, View, product};
use crate::network::add;

/// Which numbers of the input each window holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Windows {
    /// How many of the first numbers of the input are passed on as they are.
    pub kept: usize,
    /// Numbers in a window.
    pub window: usize,
    /// `positions x window`.
    pub indices: Vec<u32>,
}

/// What a backward pass needs of the forward pass, and its workspace.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// The numbers of all windows, `rows x positions x window`.
    windows: Vec<f32>,
    /// Gradient of `windows`.
    slopes: Vec<f32>,
    /// Answers or their gradients, `rows x positions x filters`.
    answers: Vec<f32>,
}

impl Windows {
    /// How many windows there are.
    pub fn positions(&self) -> usize {
        self.indices.len() / self.window
    }

    /// Numbers that it gives with so many filters: those passed on, then the filters' answers,
    /// window by window.
    pub fn outputs(&self, filters: usize) -> usize {
        self.kept + self.positions() * filters
    }

    /// Whether it fits an input of so many numbers.
    pub(crate) fn fits(&self, inputs: usize) -> bool {
        self.window > 0
            && self.kept <= inputs
            && self.indices.len().is_multiple_of(self.window)
            && self.indices.iter().all(|k| (*k as usize) < inputs)
    }

    /// Writes `rows x outputs` for `input`, `rows x inputs`, with weights of `filters x
    /// window`.
    pub(crate) fn forward(
        &self,
        (input, inputs): (&[f32], usize),
        (weights, bias): (&[f32], &[f32]),
        seen: &mut Seen,
        output: &mut Vec<f32>,
    ) {
        let filters = bias.len();
        seen.windows.clear();
        for row in input.chunks_exact(inputs) {
            let numbers = self.indices.iter().map(|k| row[*k as usize]);
            seen.windows.extend(numbers);
        }
        let rows = seen.windows.len() / self.window;
        seen.answers.clear();
        for _ in 0..rows {
            seen.answers.extend_from_slice(bias);
        }
        product(
            &mut seen.answers,
            Old::Add,
            View::new(&seen.windows, rows, self.window),
            View::new(weights, filters, self.window).transposed(),
        );
        output.clear();
        let answers = seen.answers.chunks_exact(self.positions() * filters);
        for (row, answers) in input.chunks_exact(inputs).zip(answers) {
            output.extend_from_slice(&row[..self.kept]);
            output.extend(answers.iter().map(|answer| answer.max(0.0)));
        }
    }

    /// The gradients, each if requested: of weights and bias, and of the input, from that of
    /// the output after the forward pass that has seen it.
    pub(crate) fn backward(
        &self,
        (output, delta): (&[f32], &[f32]),
        weights: &[f32],
        seen: &mut Seen,
        gradient: Option<(&mut [f32], &mut [f32])>,
        of_input: Option<(&mut [f32], usize)>,
    ) {
        let filters = weights.len() / self.window;
        let outputs = self.outputs(filters);
        let Seen {
            windows,
            slopes,
            answers,
        } = seen;
        answers.clear();
        let rows = output
            .chunks_exact(outputs)
            .zip(delta.chunks_exact(outputs));
        for (output, delta) in rows {
            let numbers = output[self.kept..].iter().zip(&delta[self.kept..]);
            answers.extend(numbers.map(|(y, delta)| if *y > 0.0 { *delta } else { 0.0 }));
        }
        let rows = windows.len() / self.window;
        let deltas = View::new(answers, rows, filters);
        if let Some((of_weights, of_bias)) = gradient {
            let windows = View::new(windows, rows, self.window);
            product(of_weights, Old::Replace, deltas.transposed(), windows);
            of_bias.fill(0.0);
            let rows = answers.chunks_exact(filters);
            rows.for_each(|row| add(of_bias, row));
        }
        let Some((of_input, inputs)) = of_input else {
            return;
        };
        slopes.resize(windows.len(), 0.0);
        let weights = View::new(weights, filters, self.window);
        product(slopes, Old::Replace, deltas, weights);
        of_input.fill(0.0);
        let rows = slopes.chunks_exact(self.indices.len());
        let rows = rows.zip(delta.chunks_exact(outputs));
        for (row, (slopes, delta)) in of_input.chunks_exact_mut(inputs).zip(rows) {
            row[..self.kept].copy_from_slice(&delta[..self.kept]);
            for (index, slope) in self.indices.iter().zip(slopes) {
                row[*index as usize] += slope;
            }
        }
    }
}
