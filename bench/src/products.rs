//! The matrix products of an update and nothing else: an upper limit for an
//! update with these products.

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
    /// Groups of rows that the first layer multiplies once; without groups, the rows.
    pub groups: usize,
    /// Whether there is a backward pass.
    pub backward: bool,
    /// Whether it computes the gradient of the weights.
    pub weights: bool,
}

impl Pass {
    /// Rows of a part of [`ROWS`] groups.
    fn rows_of_part(&self) -> usize {
        (ROWS * self.rows).div_ceil(self.groups.max(1))
    }
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
        let groups = passes.iter().map(|pass| pass.groups).max().unwrap_or(0);
        let widest = passes.iter().flat_map(|pass| pass.sizes).max().unwrap_or(0);
        let part = passes.iter().map(|pass| pass.rows_of_part()).max();
        let most = widest * widest.max(part.unwrap_or(0));
        Buffers {
            operands: vec![0.5; most],
            results: vec![vec![0.0; most]; groups.div_ceil(ROWS)],
        }
    }

    /// Computes the products of all passes; the rows are split among threads as a network
    /// splits them.
    pub fn multiply(&mut self, passes: &[Pass], threads: usize) {
        let operands = &self.operands[..];
        for pass in passes {
            let begins = (0..pass.groups).step_by(ROWS);
            let parts = begins.zip(&mut self.results);
            share(threads, parts, |(begin, result)| {
                let groups = ROWS.min(pass.groups - begin);
                let rows = groups * pass.rows / pass.groups;
                multiply_rows(pass, (groups, rows), operands, result);
            });
        }
    }
}

fn multiply_rows(
    pass: &Pass,
    (groups, rows): (usize, usize),
    operands: &[f32],
    result: &mut [f32],
) {
    let view = |rows: usize, columns: usize| View::new(&operands[..rows * columns], rows, columns);
    let layers = pass.sizes.windows(2).map(|pair| (pair[0], pair[1]));
    let rows = |layer: usize| if layer == 0 { groups } else { rows };
    for (k, (inputs, outputs)) in layers.clone().enumerate() {
        let (before, weights) = (view(rows(k), inputs), view(outputs, inputs));
        let after = &mut result[..rows(k) * outputs];
        product(after, Old::Replace, before, weights.transposed());
    }
    if !pass.backward {
        return;
    }
    for (k, (inputs, outputs)) in layers.enumerate() {
        let deltas = view(rows(k), outputs);
        if pass.weights {
            let slopes = &mut result[..outputs * inputs];
            let inputs = view(rows(k), inputs);
            product(slopes, Old::Replace, deltas.transposed(), inputs);
        }
        if k > 0 {
            let before = &mut result[..rows(k) * inputs];
            product(before, Old::Replace, deltas, view(outputs, inputs));
        }
    }
}
