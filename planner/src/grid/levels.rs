use std::ops::Range;

use super::{WORD, from_column, to_column};
use crate::search::widely;

/// Rows that a word of a level holds together: each level four times as many as the one
/// before, so that four overlapping words hold any number of rows up to [`ROWS_MAX`].
const ROWS: [usize; 2] = [4, 16];
/// Most rows of a rectangle.
const ROWS_MAX: usize = 64;

/// What is occupied in any of some rows, from each row on: whether a rectangle of the grid
/// is free is then seen in eight words, without a loop, whose end a processor cannot foresee.
///
/// It is filled once for a search, and only of the rows that are not occupied throughout.
#[derive(Debug)]
pub(super) struct Levels {
    words: [Box<[u64]>; ROWS.len()],
    /// All other rows are occupied throughout.
    rows: Range<usize>,
    /// How many words of each row are filled in.
    filled: usize,
}

impl Levels {
    /// The only place that allocates.
    pub(super) fn new(word_count: usize) -> Self {
        Self {
            words: ROWS.map(|_| vec![0; word_count].into_boxed_slice()),
            rows: 0..0,
            filled: 0,
        }
    }

    /// Nothing is filled in; the grid has changed, and all but these rows are occupied.
    pub(super) fn begin(&mut self, rows: Range<usize>) {
        (self.rows, self.filled) = (rows, 0);
    }

    /// Puts the rows of the first words of a grid together.
    pub(super) fn fill(&mut self, grid: &[u64], all_rows: usize, filled: usize) {
        let Range { start, end } = self.rows;
        let [fours, sixteens] = &mut self.words;
        widely(
            #[inline(always)]
            || {
                for word in 0..filled {
                    let column = word * all_rows..(word + 1) * all_rows;
                    let grid = &grid[column.clone()][start..end];
                    let fours = &mut fours[column.clone()][start..end];
                    put_together(grid, fours, 1);
                    put_together(fours, &mut sixteens[column][start..end], ROWS[0]);
                }
            },
        );
        self.filled = filled;
    }

    /// Whether the cells of some rows and columns, first to last, are free; `None` of a
    /// rectangle that is too large, or not filled in.
    #[inline(always)]
    pub(super) fn is_free(
        &self,
        grid: &[u64],
        all_rows: usize,
        (rows, columns): ((usize, usize), (usize, usize)),
    ) -> Option<bool> {
        let (head, tail) = (columns.0 / WORD, columns.1 / WORD);
        let count = rows.1 + 1 - rows.0;
        if tail >= self.filled || tail > head + 1 || count > ROWS_MAX {
            return None;
        }
        if rows.0 < self.rows.start || rows.1 >= self.rows.end {
            return Some(false);
        }
        let (words, span) = match count {
            0..4 => (grid, 1),
            4..16 => (&*self.words[0], ROWS[0]),
            _ => (&*self.words[1], ROWS[1]),
        };
        let last = rows.1 + 1 - span;
        let at = [0, 1, 2, 3].map(|piece| (rows.0 + piece * span).min(last));
        let occupied = |word: usize| {
            let words = &words[word * all_rows..(word + 1) * all_rows];
            words[at[0]] | words[at[1]] | words[at[2]] | words[at[3]]
        };
        let (from, to) = (from_column(columns.0), to_column(columns.1));
        // In one word, both masks hold; which of the two it is cannot be foreseen.
        let (head_mask, tail_mask) = match head == tail {
            true => (from & to, from & to),
            false => (from, to),
        };
        Some(occupied(head) & head_mask | occupied(tail) & tail_mask == 0)
    }
}

/// Writes what is occupied in four words, so many apart, from each word on.
#[inline(always)]
fn put_together(words: &[u64], fours: &mut [u64], apart: usize) {
    let Some(count) = words.len().checked_sub(3 * apart) else {
        return;
    };
    let from = |piece: usize| &words[piece * apart..][..count];
    let (a, b, c, d) = (from(0), from(1), from(2), from(3));
    for (index, four) in fours[..count].iter_mut().enumerate() {
        *four = a[index] | b[index] | c[index] | d[index];
    }
}

#[cfg(test)]
mod tests;
