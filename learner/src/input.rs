//! The input of a batch: rows, or groups of rows that begin with the same numbers.

use std::ops::Range;

use crate::matrix::{Old, View, product, product_into};
use crate::network::add;

/// The input of a batch.
#[derive(Clone, Copy, Debug)]
pub enum Input<'a> {
    /// `rows x inputs`.
    Rows(&'a [f32]),
    /// Groups of rows, such as a state with several actions.
    Groups(Groups<'a>),
}

/// Groups of rows that begin with the same numbers. The first layer multiplies these once for
/// a group.
#[derive(Clone, Copy, Debug)]
pub struct Groups<'a> {
    /// How the rows of each group begin, `groups x common`.
    pub common: &'a [f32],
    /// How each row goes on, `rows x own`; `common` and `own` together are the inputs.
    pub own: &'a [f32],
    /// How many rows each group has.
    pub rows: &'a [usize],
}

/// Memory for the first layer's passes over groups.
#[derive(Clone, Debug, Default)]
pub(crate) struct Workspace {
    /// Of each group the products of what its rows have in common, or the sum of the gradients
    /// of its rows, `groups x sums`.
    groups: Vec<f32>,
    /// The weights of the rows' own numbers, or their gradients, `own x sums`: so the numbers of
    /// an inner loop follow one another.
    own: Vec<f32>,
}

impl<'a, T: AsRef<[f32]> + ?Sized> From<&'a T> for Input<'a> {
    fn from(rows: &'a T) -> Self {
        Input::Rows(rows.as_ref())
    }
}

impl<'a> From<Groups<'a>> for Input<'a> {
    fn from(groups: Groups<'a>) -> Self {
        Input::Groups(groups)
    }
}

impl<'a> Input<'a> {
    /// The input in parts of so many groups, or rows, for a network with so many inputs; each
    /// with the range of its rows.
    ///
    /// # Panics
    /// When groups have another size.
    pub(crate) fn parts(
        self,
        count: usize,
        inputs: usize,
    ) -> impl ExactSizeIterator<Item = (Input<'a>, Range<usize>)> + DoubleEndedIterator + Clone + Send
    {
        let groups = match self {
            Input::Rows(rows) => rows.len().div_ceil(inputs),
            Input::Groups(groups) => {
                groups.check(inputs);
                groups.rows.len()
            }
        };
        (0..groups.div_ceil(count)).map(move |part| {
            let range = part * count..groups.min((part + 1) * count);
            match self {
                Input::Rows(rows) => {
                    let end = rows.len().min(range.end * inputs);
                    (Input::Rows(&rows[range.start * inputs..end]), range)
                }
                Input::Groups(groups) => {
                    let (part, range) = groups.part(range, inputs);
                    (Input::Groups(part), range)
                }
            }
        })
    }

    /// The rows.
    ///
    /// # Panics
    /// When they are groups.
    pub(crate) fn rows(self) -> &'a [f32] {
        match self {
            Input::Rows(rows) => rows,
            Input::Groups(_) => panic!("a convolution takes no groups of rows"),
        }
    }

    /// Writes the products of a layer, `rows x sums`, with its weights, `sums x inputs`.
    pub(crate) fn products(self, weights: View, workspace: &mut Workspace, out: &mut Vec<f32>) {
        let (sums, inputs) = weights.size();
        match self {
            Input::Rows(rows) => {
                let rows = View::new(rows, rows.len() / inputs, inputs);
                out.resize(rows.size().0 * sums, 0.0);
                product(out, Old::Replace, rows, weights.transposed());
            }
            Input::Groups(groups) => groups.products(weights, workspace, out),
        }
    }

    /// Writes the gradient of the weights, `sums x inputs`, from that of the sums, `rows x sums`.
    pub(crate) fn slopes(
        self,
        (delta, sums): (&[f32], usize),
        workspace: &mut Workspace,
        out: &mut [f32],
    ) {
        let inputs = out.len() / sums;
        match self {
            Input::Rows(rows) => {
                let count = delta.len() / sums;
                let delta = View::new(delta, count, sums).transposed();
                product(out, Old::Replace, delta, View::new(rows, count, inputs));
            }
            Input::Groups(groups) => groups.slopes((delta, sums), workspace, (out, inputs)),
        }
    }

    /// Writes the gradient of the rows, `rows x inputs`, or of the numbers that each row of a
    /// group has of its own, `rows x own`, from that of the sums, `rows x sums`.
    pub(crate) fn own_slopes(self, delta: View, weights: View, out: &mut Vec<f32>) {
        let weights = match self {
            Input::Rows(_) => weights,
            Input::Groups(groups) => weights.columns(groups.common_len()..weights.size().1),
        };
        out.resize(delta.size().0 * weights.size().1, 0.0);
        product(out, Old::Replace, delta, weights);
    }
}

impl<'a> Groups<'a> {
    /// How many numbers the rows of a group have in common.
    fn common_len(&self) -> usize {
        self.common.len() / self.rows.len().max(1)
    }

    fn check(&self, inputs: usize) {
        let common = self.common_len();
        let rows: usize = self.rows.iter().sum();
        let fits = common <= inputs
            && self.common.len() == common * self.rows.len()
            && self.own.len() == rows * (inputs - common);
        assert!(fits, "groups of rows of another size");
    }

    /// These of the groups, and which rows they are.
    fn part(self, range: Range<usize>, inputs: usize) -> (Groups<'a>, Range<usize>) {
        let common = self.common_len();
        let own = inputs - common;
        let start: usize = self.rows[..range.start].iter().sum();
        let end = start + self.rows[range.clone()].iter().sum::<usize>();
        let part = Groups {
            common: &self.common[range.start * common..range.end * common],
            own: &self.own[start * own..end * own],
            rows: &self.rows[range],
        };
        (part, start..end)
    }

    fn products(&self, weights: View, workspace: &mut Workspace, out: &mut Vec<f32>) {
        let (sums, inputs) = weights.size();
        let Workspace { groups, own } = workspace;
        groups.resize(self.rows.len() * sums, 0.0);
        let common = View::new(self.common, self.rows.len(), self.common_len());
        let of_common = weights.columns(0..self.common_len()).transposed();
        product(groups, Old::Replace, common, of_common);
        weights
            .columns(self.common_len()..inputs)
            .write_columns(own);
        out.clear();
        let mut numbers = self.own.iter();
        for (products, rows) in groups.chunks_exact(sums).zip(self.rows) {
            for _ in 0..*rows {
                let begin = out.len();
                out.extend_from_slice(products);
                for (weights, number) in own.chunks_exact(sums).zip(&mut numbers) {
                    add_times(&mut out[begin..], weights, *number);
                }
            }
        }
    }

    fn slopes(
        &self,
        (delta, sums): (&[f32], usize),
        workspace: &mut Workspace,
        (out, inputs): (&mut [f32], usize),
    ) {
        let Workspace { groups, own } = workspace;
        groups.clear();
        groups.resize(self.rows.len() * sums, 0.0);
        own.clear();
        own.resize((inputs - self.common_len()) * sums, 0.0);
        let (mut deltas, mut numbers) = (delta.chunks_exact(sums), self.own.iter());
        for (group, rows) in groups.chunks_exact_mut(sums).zip(self.rows) {
            for delta in deltas.by_ref().take(*rows) {
                add(group, delta);
                for (slopes, number) in own.chunks_exact_mut(sums).zip(&mut numbers) {
                    add_times(slopes, delta, *number);
                }
            }
        }
        let groups = View::new(groups, self.rows.len(), sums).transposed();
        let common = View::new(self.common, self.rows.len(), self.common_len());
        product_into((out, inputs), Old::Replace, groups, common);
        for (k, slopes) in own.chunks_exact(sums).enumerate() {
            let column = out.iter_mut().skip(self.common_len() + k).step_by(inputs);
            column.zip(slopes).for_each(|(out, slope)| *out = *slope);
        }
    }
}

/// Adds numbers times a factor to these.
fn add_times(sums: &mut [f32], numbers: &[f32], factor: f32) {
    let pairs = sums.iter_mut().zip(numbers);
    pairs.for_each(|(sum, number)| *sum += factor * number);
}
