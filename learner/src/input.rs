//! The input of a batch: rows, or groups of rows that begin with the same numbers.

use std::ops::Range;

use crate::matrix::{Old, View, ViewMut, product, product_into};
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
    ) -> impl ExactSizeIterator<Item = (Input<'a>, Range<usize>)> + Send {
        if let Input::Groups(groups) = self {
            groups.check(inputs);
        }
        let groups = match self {
            Input::Rows(rows) => rows.len().div_ceil(inputs),
            Input::Groups(groups) => groups.rows.len(),
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
}

impl<'a> Groups<'a> {
    /// Numbers with which each group begins.
    fn begins(&self) -> usize {
        self.common.len() / self.rows.len().max(1)
    }

    fn check(&self, inputs: usize) {
        let begins = self.begins();
        let rows: usize = self.rows.iter().sum();
        let fits = begins <= inputs
            && self.common.len() == begins * self.rows.len()
            && self.own.len() == rows * (inputs - begins);
        assert!(fits, "groups of rows of another size");
    }

    /// These of the groups, and which rows they are.
    fn part(self, range: Range<usize>, inputs: usize) -> (Groups<'a>, Range<usize>) {
        let begins = self.begins();
        let own = inputs - begins;
        let start: usize = self.rows[..range.start].iter().sum();
        let end = start + self.rows[range.clone()].iter().sum::<usize>();
        let part = Groups {
            common: &self.common[range.start * begins..range.end * begins],
            own: &self.own[start * own..end * own],
            rows: &self.rows[range],
        };
        (part, start..end)
    }

    /// The numbers that only one row has, `rows x own`, and which of the inputs they are.
    fn own(&self, inputs: usize) -> (View<'a>, Range<usize>) {
        let range = self.begins()..inputs;
        let rows = self.rows.iter().sum();
        (View::new(self.own, rows, range.len()), range)
    }

    /// Writes the products of a layer, `rows x sums`, with weights of `sums x inputs`; `each` is a
    /// workspace.
    pub(crate) fn forward(&self, weights: View, each: &mut Vec<f32>, out: &mut Vec<f32>) {
        let (sums, inputs) = weights.size();
        each.resize(self.rows.len() * sums, 0.0);
        let common = View::new(self.common, self.rows.len(), self.begins());
        let of_common = weights.columns(0..self.begins()).transposed();
        product(each, Old::Replace, common, of_common);
        let (own, range) = self.own(inputs);
        out.resize(own.size().0 * sums, 0.0);
        product(out, Old::Replace, own, weights.columns(range).transposed());
        let mut rows = out.chunks_exact_mut(sums);
        for (each, count) in each.chunks_exact(sums).zip(self.rows) {
            for row in rows.by_ref().take(*count) {
                add(row, each);
            }
        }
    }

    /// Writes the gradient of the weights from that of the sums, `rows x sums`; `each` is a
    /// workspace.
    pub(crate) fn slopes(
        &self,
        (delta, sums): (&[f32], usize),
        each: &mut Vec<f32>,
        (slopes, inputs): (&mut [f32], usize),
    ) {
        each.clear();
        let mut rows = delta.chunks_exact(sums);
        for &count in self.rows {
            let begin = each.len();
            each.resize(begin + sums, 0.0);
            for row in rows.by_ref().take(count) {
                add(&mut each[begin..], row);
            }
        }
        let each = View::new(each, self.rows.len(), sums).transposed();
        let common = View::new(self.common, self.rows.len(), self.begins());
        let of_common = ViewMut::new(slopes, sums, inputs).columns(0..self.begins());
        product_into(of_common, Old::Replace, each, common);
        let (own, range) = self.own(inputs);
        let of_own = ViewMut::new(slopes, sums, inputs).columns(range);
        let delta = View::new(delta, own.size().0, sums).transposed();
        product_into(of_own, Old::Replace, delta, own);
    }

    /// Writes the gradient of the rows' own numbers, `rows x own`, from that of the sums.
    pub(crate) fn own_slopes(&self, delta: View, weights: View, out: &mut Vec<f32>) {
        let (own, range) = self.own(weights.size().1);
        let (rows, columns) = own.size();
        out.resize(rows * columns, 0.0);
        product(out, Old::Replace, delta, weights.columns(range));
    }
}
