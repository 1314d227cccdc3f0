use clarabel::algebra::CscMatrix;

/// A sparse matrix whose pattern is fixed once, so that the solver can keep its
/// symbolic factorisation, and whose values change.
#[derive(Debug)]
pub(crate) struct Sparse {
    pub(crate) matrix: CscMatrix<f64>,
    /// Where each entry, in the order it was declared, is among the values.
    slots: Vec<usize>,
}

impl Sparse {
    /// From the places of its entries, each (row, column), none twice.
    pub(crate) fn new(rows: usize, columns: usize, entries: &[(usize, usize)]) -> Self {
        let mut order: Vec<usize> = (0..entries.len()).collect();
        order.sort_by_key(|&entry| (entries[entry].1, entries[entry].0));
        let mut slots = vec![0; entries.len()];
        for (slot, &entry) in order.iter().enumerate() {
            slots[entry] = slot;
        }
        let mut column_starts = vec![0; columns + 1];
        for &(_, column) in entries {
            column_starts[column + 1] += 1;
        }
        for column in 0..columns {
            column_starts[column + 1] += column_starts[column];
        }
        let row_indices = order.iter().map(|&entry| entries[entry].0).collect();
        let values = vec![0.0; entries.len()];
        Self {
            matrix: CscMatrix::new(rows, columns, column_starts, row_indices, values),
            slots,
        }
    }

    /// Writes the values, in the order the entries were declared.
    pub(crate) fn write(&mut self, values: &[f64]) {
        for (&slot, &value) in self.slots.iter().zip(values) {
            self.matrix.nzval[slot] = value;
        }
    }
}
