//! The matrix products of an update and nothing else: the limit of what any
//! program that uses the same library can reach.

use learner::matrix::{Old, View, product};
use learner::network::ROWS;
use learner::share::share;

/// One pass of a batch through a network, and what goes back.
#[derive(Clone, Copy, Debug)]
pub struct Pass {
    /// Numbers in and out of each layer: `sizes[k]` to `sizes[k + 1]`.
    pub sizes: [usize; 4],
    /// Rows of the batch.
    pub rows: usize,
    /// The slopes of the weights are wanted.
    pub weights: bool,
    /// The slopes of the inputs are wanted.
    pub inputs: bool,
}

/// Memory for the products, kept from one update to the next. No number in it
/// matters, so every product reads the same operands.
pub struct Room {
    operands: Vec<f32>,
    /// One for each part of a batch.
    results: Vec<Vec<f32>>,
}

impl Room {
    /// Room for these passes.
    pub fn new(passes: &[Pass]) -> Room {
        let rows = passes.iter().map(|pass| pass.rows).max().unwrap_or(0);
        let widest = passes.iter().flat_map(|pass| pass.sizes).max().unwrap_or(0);
        let most = widest * widest.max(ROWS);
        Room {
            operands: vec![0.5; most],
            results: vec![vec![0.0; most]; rows.div_ceil(ROWS)],
        }
    }

    /// Makes the products of all passes, their rows shared as a network shares them.
    pub fn multiply(&mut self, passes: &[Pass], threads: usize) {
        let operands = &self.operands[..];
        for pass in passes {
            let begins = (0..pass.rows).step_by(ROWS);
            let parts = begins.zip(&mut self.results);
            share(threads, parts, |(begin, result)| {
                multiply_rows(pass, ROWS.min(pass.rows - begin), operands, result);
            });
        }
    }
}

fn multiply_rows(pass: &Pass, rows: usize, operands: &[f32], result: &mut [f32]) {
    let view = |rows: usize, columns: usize| View::new(&operands[..rows * columns], rows, columns);
    let layers = pass.sizes.windows(2).map(|pair| (pair[0], pair[1]));
    for (inputs, outputs) in layers.clone() {
        let (before, weights) = (view(rows, inputs), view(outputs, inputs));
        let after = &mut result[..rows * outputs];
        product(after, Old::Replace, before, weights.transposed());
    }
    for (k, (inputs, outputs)) in layers.enumerate() {
        let deltas = view(rows, outputs);
        if pass.weights {
            let slopes = &mut result[..outputs * inputs];
            product(
                slopes,
                Old::Replace,
                deltas.transposed(),
                view(rows, inputs),
            );
        }
        if pass.inputs || (pass.weights && k > 0) {
            let before = &mut result[..rows * inputs];
            product(before, Old::Replace, deltas, view(outputs, inputs));
        }
    }
}
