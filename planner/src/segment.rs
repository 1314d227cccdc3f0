use vehicle::Point;

/// How near a line must come to a cell to touch it, in cells. Coordinates of at
/// most 4096 cells carry rounding errors below 1e-12, a thousandth of this, so
/// no cell that the line truly crosses is missed.
const TOUCH: f64 = 1e-9;

/// The columns `first..=last` of one row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Run {
    pub(crate) row: usize,
    pub(crate) first: usize,
    pub(crate) last: usize,
}

/// A straight line over the grid, in cells: x counts columns, y counts rows.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Segment {
    from: Point,
    to: Point,
    /// The last cell along x and along y.
    last_column: usize,
    last_row: usize,
}

impl Segment {
    /// Both ends are inside the grid; an end on the grid's outer edge touches
    /// the cells inside it.
    #[inline(always)]
    pub(crate) fn new(from: Point, to: Point, last_column: usize, last_row: usize) -> Self {
        // Upwards, so that rows are entered at their lower edge.
        let (from, to) = if from.y <= to.y {
            (from, to)
        } else {
            (to, from)
        };
        Self {
            from,
            to,
            last_column,
            last_row,
        }
    }

    /// First and last row of all that it touches.
    #[inline(always)]
    pub(crate) fn rows(&self) -> (usize, usize) {
        cells(self.from.y, self.to.y, self.last_row)
    }

    /// First and last column of all that it touches.
    #[inline(always)]
    pub(crate) fn columns(&self) -> (usize, usize) {
        let (low, high) = (self.from.x.min(self.to.x), self.from.x.max(self.to.x));
        cells(low, high, self.last_column)
    }

    /// The first and last column that it touches in some of its rows, given first
    /// to last: between where it enters and where it leaves them.
    pub(crate) fn columns_in(&self) -> impl Fn((usize, usize)) -> (usize, usize) {
        let Self { from, to, .. } = *self;
        let rise = to.y - from.y;
        let is_level = rise <= TOUCH;
        let columns_per_row = (to.x - from.x) / rise;
        let (all, last_column) = (self.columns(), self.last_column);
        let x_at = move |y: f64| from.x + (y.max(from.y).min(to.y) - from.y) * columns_per_row;
        move |(first, last)| {
            // Within a touch of one height it may be anywhere along x.
            if is_level {
                return all;
            }
            let enter = x_at(first as f64 - TOUCH);
            let leave = x_at(last as f64 + 1.0 + TOUCH);
            cells(enter.min(leave), enter.max(leave), last_column)
        }
    }
}

/// First and last cell that an interval touches along one axis, at most `last`.
#[inline(always)]
pub(crate) fn cells(low: f64, high: f64, last: usize) -> (usize, usize) {
    // 32 bits hold every count of cells, and convert at a fraction of the cost
    // of 64. Truncating is floor for what is positive, and saturates.
    let cell = |at: f64| (at as i32).max(0).min(last as i32) as usize;
    (cell(low - TOUCH), cell(high + TOUCH))
}
