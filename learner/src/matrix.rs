//! The only place that passes slices to the matrix library.

use std::ops::Range;

use gemm_common::Parallelism;

/// A matrix in a slice: element `(r, c)` is `data[r * row_stride + c * column_stride]`.
#[derive(Clone, Copy)]
pub struct View<'a> {
    data: &'a [f32],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

impl<'a> View<'a> {
    /// A matrix whose rows follow one another.
    ///
    /// # Panics
    /// When the slice has another length.
    pub fn new(data: &'a [f32], rows: usize, columns: usize) -> Self {
        assert_eq!(data.len(), rows * columns, "a matrix of another size");
        Self {
            data,
            rows,
            columns,
            row_stride: columns,
            column_stride: 1,
        }
    }

    /// Rows and columns.
    pub fn size(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    /// Some of its columns, on the same numbers.
    ///
    /// # Panics
    /// When it has fewer.
    pub fn columns(self, range: Range<usize>) -> Self {
        assert!(range.end <= self.columns, "columns of a narrower matrix");
        Self {
            data: &self.data[(range.start * self.column_stride).min(self.data.len())..],
            columns: range.len(),
            ..self
        }
    }

    /// Writes its numbers column by column.
    pub fn write_columns(&self, out: &mut Vec<f32>) {
        out.clear();
        for column in 0..self.columns {
            let begin = column * self.column_stride;
            let at = (0..self.rows).map(|row| begin + row * self.row_stride);
            out.extend(at.map(|at| self.data[at]));
        }
    }

    /// The transposed matrix, on the same numbers.
    pub fn transposed(self) -> Self {
        Self {
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
            ..self
        }
    }
}

/// What happens to the numbers in the output.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Old {
    /// They are overwritten.
    Replace,
    /// The product is added to them.
    Add,
}

/// `out = a b`, or `out += a b`, on the calling thread; the rows of `out` follow one
/// another.
///
/// # Panics
/// When the sizes do not fit.
pub fn product(out: &mut [f32], old: Old, a: View, b: View) {
    product_into((out, b.columns), old, a, b);
}

/// The same into the first columns of a matrix whose rows have so many numbers.
///
/// # Panics
/// When the sizes do not fit.
pub fn product_into((out, row_stride): (&mut [f32], usize), old: Old, a: View, b: View) {
    assert_eq!(a.columns, b.rows, "inner sizes differ");
    assert_eq!(out.len(), a.rows * row_stride, "a result of another size");
    assert!(b.columns <= row_stride, "columns of a narrower matrix");
    // The kernel wants an output whose columns follow one another. Rows that do are the
    // columns of the transposed product: transpose(a b) = transpose(b) transpose(a).
    let (a, b, row_stride, column_stride) = match b.columns {
        0 | 1 => (a, b, row_stride, 1),
        _ => (b.transposed(), a.transposed(), 1, row_stride),
    };
    // SAFETY: `new`, `columns` and `transposed` keep every (row, column) within the slice,
    // the asserts above keep those of the result within `out`, and `out` is borrowed
    // mutably, so nothing else reads or writes it.
    #[allow(unsafe_code)]
    unsafe {
        gemm_f32::gemm::f32::get_gemm_fn()(
            a.rows,
            b.columns,
            a.columns,
            out.as_mut_ptr(),
            column_stride as isize,
            row_stride as isize,
            old == Old::Add,
            a.data.as_ptr(),
            a.column_stride as isize,
            a.row_stride as isize,
            b.data.as_ptr(),
            b.column_stride as isize,
            b.row_stride as isize,
            1.0,
            1.0,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}
