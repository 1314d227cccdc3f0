//! The matrix products of an update and nothing else: an upper limit for every
//! program that uses the same library.

use learner::matrix::{Old, View, product};
use learner::network::ROWS;
use learner::share::share;

/// Forward pass of a batch through a network, and its backward pass.
#[derive(Clone, Copy, Debug)]
pub struct Pass {
    /// Numbers in and out of each layer: `sizes[k]` to `sizes[k + 1]`.
    pub sizes: [usize; 4],
    /// Rows of the batch.
    pub rows: usize,
    /// The backward pass computes the gradient of the weights.
    pub weights: bool,
    /// The backward pass computes the gradient of the inputs.
    pub inputs: bool,
}

/// Buffers for the products, reused by every update. The values do not affect the
/// time, so every product reads the same operands.
pub struct Buffers {
    operands: Vec<f32>,
    /// One buffer for each part of a batch.
    results: Vec<Vec<f32>>,
}

impl Buffers {
    /// Allocates buffers for these passes.
    pub fn new(passes: &[Pass]) -> Buffers {
        let rows = passes.iter().map(|pass| pass.rows).max().unwrap_or(0);
        let widest = passes.iter().flat_map(|pass| pass.sizes).max().unwrap_or(0);
        let most = widest * widest.max(ROWS);
        Buffers {
            operands: vec![0.5; most],
            results: vec![vec![0.0; most]; rows.div_ceil(ROWS)],
        }
    }

    /// Computes the products of all passes; the rows are split among threads as a network
    /// splits them.
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
