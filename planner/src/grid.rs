use shm_config::message::Observation;
#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Footprint, Point, Vehicle};

use crate::PlannerConfig;
use crate::corridor::Corridor;
#[cfg(feature = "std")]
use crate::memory::own_words;
use crate::memory::{GridWords, Place, exactly};
use crate::segment::{Run, Segment};
#[cfg(feature = "std")]
use levels::Levels;
use shm_config::settings::planner::DISC_CELLS_MAX;
use tracker::Beams;

mod arc;
#[cfg(feature = "std")]
mod levels;
mod road;
mod unseen;

/// Most points of the body that are protected at the start.
pub(crate) const STARTS_MAX: usize = 4;
/// A line whose bounding box is not free is tested in pieces of so many rows.
const PIECE_ROWS: usize = 8;
/// Beams that are looked at together.
const BEAMS: usize = 16;
/// Cells in a word.
const WORD: usize = u64::BITS as usize;

/// Columns, and rows on either side of the x axis, of the configured grid.
fn cells(config: &PlannerConfig) -> [usize; 2] {
    let cells_per_m = 1.0 / config.cell_m;
    // A millionth of a cell: 30 / 0.05 must not become 601.
    let cells = |length_m: f64| (length_m * cells_per_m - 1e-6).ceil().max(1.0) as usize;
    [cells(config.x_max_m), cells(config.y_max_m)]
}

/// Words of the configured grid.
pub(crate) fn word_count(config: &PlannerConfig) -> usize {
    let [columns, half_rows] = cells(config);
    columns.div_ceil(WORD) * 2 * half_rows
}

/// A cell of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cell {
    /// Counts along x from the car.
    pub column: usize,
    /// Counts along y from the right edge of the grid.
    pub row: usize,
}

/// The occupancy grid of Sec. 4.1.1 in the body frame: x in `[0, x_max]`, y in
/// `[-y_max, y_max]`, one bit a cell.
///
/// A cell is occupied when its row's middle is outside the lane corridor, or
/// when it is within the inflation radius of a cell that holds a lidar return,
/// middle to middle. So is a cell ahead of the front bumper at which no beam looks.
///
/// # The start
/// The car stands at the origin, on the edge between two cells. Those two are
/// never occupied: the corridor is widened to hold them
/// ([`Corridor::with_start`]), and the disc around a return is made smaller, to
/// less than the return's distance from the nearer of the two. So the clearance
/// required of a cell is the lesser of the inflation radius and the car's present
/// clearance: from a start that is already too near to an obstacle, a path is free if
/// and only if it comes no nearer.
#[derive(Debug)]
pub struct Grid {
    cell_m: f64,
    cells_per_m: f64,
    columns: usize,
    /// Rows on either side of the x axis.
    half_rows: usize,
    lane_margin_m: f64,
    /// Inflation radius squared, in cells, with room for the rounding of
    /// radius / cell.
    disc_squared: i64,
    /// Column reach of the full disc for each row offset from its middle.
    disc: heapless::Vec<i64, { DISC_CELLS_MAX + 1 }>,
    beams: Beams,
    corridor: Corridor,
    /// The car's rectangle: unseen cells ahead of it are occupied.
    footprint: Footprint,
    /// Columns of the cells on either side of the x axis that are never
    /// occupied: the car's.
    starts: heapless::Vec<i64, STARTS_MAX>,
    /// 64 columns a word, the lowest bit nearest to the car. All rows of the first
    /// 64 columns, then of the next: the rows of a rectangle lie side by side.
    words: Place<[u64]>,
    #[cfg(feature = "std")]
    levels: Levels,
}

impl Grid {
    /// A grid of the configured size, occupied everywhere; the only place that
    /// allocates.
    #[cfg(feature = "std")]
    pub fn new(config: &PlannerConfig) -> Self {
        Self::within(config, own_words(config))
    }

    /// The same grid in the caller's memory.
    ///
    /// # Panics
    /// When the settings were not checked and need more words than there are.
    pub fn within(config: &PlannerConfig, words: Place<GridWords>) -> Self {
        let cells_per_m = 1.0 / config.cell_m;
        let [columns, half_rows] = cells(config);
        let radius_cells = config.inflation_m * cells_per_m;
        let disc_squared = (radius_cells * radius_cells + 1e-6).floor() as i64;
        Self {
            cell_m: config.cell_m,
            cells_per_m,
            columns,
            half_rows,
            lane_margin_m: config.lane_margin_m,
            disc_squared,
            disc: (0..=disc_squared.isqrt().min(DISC_CELLS_MAX as i64))
                .map(|row| (disc_squared - row * row).isqrt())
                .collect(),
            beams: Beams::default(),
            corridor: Corridor {
                right_m: 0.0,
                left_m: 0.0,
            },
            footprint: Vehicle::default().footprint(),
            starts: heapless::Vec::from_array([0]),
            words: exactly(words, word_count(config)),
            #[cfg(feature = "std")]
            levels: Levels::new(word_count(config)),
        }
    }

    /// For a car of this rectangle, in place of the default one's.
    pub fn of(mut self, footprint: Footprint) -> Self {
        self.footprint = footprint;
        self
    }

    /// Number of cells along x.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of cells along y; even, the x axis is between the middle two.
    pub fn rows(&self) -> usize {
        2 * self.half_rows
    }

    /// Side of a cell, m.
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Length along x, m.
    pub fn x_max_m(&self) -> f64 {
        self.columns as f64 * self.cell_m
    }

    /// Reach to either side, m.
    pub fn y_max_m(&self) -> f64 {
        self.half_rows as f64 * self.cell_m
    }

    /// The corridor that was free before the lidar's returns; it holds the start.
    pub fn corridor(&self) -> Corridor {
        self.corridor
    }

    /// Forgets everything and marks what this observation shows.
    pub fn fill(&mut self, observation: &Observation) {
        self.corridor = Corridor::lane(&observation.road, self.lane_margin_m, self.y_max_m())
            .with_start(self.cell_m);
        let first = self.row_after(0, |y_m| y_m < self.corridor.right_m);
        let end = self.row_after(first, |y_m| y_m <= self.corridor.left_m);
        let rows = self.rows();
        for words in self.words.chunks_exact_mut(rows) {
            words[..first].fill(!0);
            words[first..end].fill(0);
            words[end..].fill(!0);
        }
        self.stamp_returns(observation);
        self.mark_unseen();
        #[cfg(feature = "std")]
        self.levels.begin(first..end);
    }

    /// The first row, from some row on, whose middle's y, m, has a property no longer that
    /// rows have up to a place.
    fn row_after(&self, from: usize, has: impl Fn(f64) -> bool) -> usize {
        let (mut low, mut high) = (from, self.rows());
        while low < high {
            let middle = (low + high) / 2;
            match has(self.row_middle_m(middle)) {
                true => low = middle + 1,
                false => high = middle,
            }
        }
        low
    }

    /// Marks what the lidar saw.
    fn stamp_returns(&mut self, observation: &Observation) {
        let fan = observation.fan();
        self.beams.prepare(fan);
        let (ranges_m, max_m) = (observation.ranges(), observation.lidar_max_m);
        let mut last = None;
        for first in (0..fan.beams).step_by(BEAMS) {
            let beams = first..fan.beams.min(first + BEAMS);
            let is_any_hit = |any: bool, range_m: &f32| any | (*range_m < max_m);
            if !ranges_m[beams.clone()].iter().fold(false, is_any_hit) {
                continue;
            }
            for beam in beams {
                // One by one, so that the rows can be written between: the directions of
                // 2,048 beams have 32 kB and are never moved.
                let hit = self.beams.hit(observation, fan.mount_body, beam);
                if let Some(return_body) = hit {
                    self.stamp_return(return_body, &mut last);
                }
            }
        }
    }

    /// Marks the disc around a return.
    fn stamp_return(&mut self, return_body: Point, last: &mut Option<(i64, i64)>) {
        let cell = self.signed_cell(return_body);
        // Near obstacles put many beams into one cell.
        if last.replace(cell) == Some(cell) {
            return;
        }
        self.stamp(cell.0, cell.1);
        // A return on the x axis belongs to the rows on both sides of it;
        // with one of them the car would see all that is straight ahead a
        // little to the left.
        if return_body.y == 0.0 {
            self.stamp(cell.0, cell.1 - 1);
        }
    }

    /// Column and row, the row counted from the x axis: 0 is the first on the
    /// left, -1 the first on the right. Either may be outside the grid.
    fn signed_cell(&self, point_body: Point) -> (i64, i64) {
        // Truncating, which is floor for what is positive: floor is a call of the library on
        // processors without an instruction for it. What saturates is outside the grid.
        let x = point_body.x * self.cells_per_m;
        let toward_zero = x as i32;
        let column = i64::from(toward_zero) - i64::from(f64::from(toward_zero) > x);
        let row = i64::from((point_body.y.abs() * self.cells_per_m) as i32);
        (column, if point_body.y < 0.0 { -1 - row } else { row })
    }

    /// Marks the disc around a return's cell, except where the start would be
    /// inside (see the type's documentation).
    fn stamp(&mut self, column: i64, row: i64) {
        let reach = self.disc.len() as i64 - 1;
        let half_rows = self.half_rows as i64;
        if column + reach < 0
            || column - reach >= self.columns as i64
            || row + reach < -half_rows
            || row - reach >= half_rows
        {
            return;
        }
        // The start's two cells are column 0 of the rows 0 and -1.
        let start_rows = row.abs().min((row + 1).abs());
        let start_columns = self.starts.iter().map(|start| (column - start).abs()).min();
        let start_columns = start_columns.unwrap_or(column);
        let start_squared = start_columns * start_columns + start_rows * start_rows;
        let shrunk = start_squared <= self.disc_squared;
        for offset in -reach..=reach {
            let columns = if shrunk {
                let left = start_squared - 1 - offset * offset;
                if left < 0 {
                    continue;
                }
                left.isqrt()
            } else {
                self.disc[offset.unsigned_abs() as usize]
            };
            let at = row + offset + half_rows;
            if (0..2 * half_rows).contains(&at) {
                self.mark(at as usize, column - columns, column + columns);
            }
        }
    }

    /// Marks the columns `first..=last` of a row, as far as they are in the grid.
    fn mark(&mut self, row: usize, first: i64, last: i64) {
        if last < 0 || first >= self.columns as i64 {
            return;
        }
        let first = first.max(0) as usize;
        let last = (last as usize).min(self.columns - 1);
        let rows = self.rows();
        for (word, mask) in words_of(first, last) {
            self.words[word * rows + row] |= mask;
        }
    }

    /// Whether any cell of a run is occupied.
    fn any(&self, run: Run) -> bool {
        let rows = self.rows();
        words_of(run.first, run.last)
            .any(|(word, mask)| self.words[word * rows + run.row] & mask != 0)
    }

    /// Whether a cell is occupied; everything outside the grid is.
    pub fn is_occupied(&self, cell: Cell) -> bool {
        if cell.column >= self.columns || cell.row >= self.rows() {
            return true;
        }
        let word = self.words[cell.column / WORD * self.rows() + cell.row];
        word >> (cell.column % WORD) & 1 != 0
    }

    /// The cell a point is in; `None` outside the grid. A point on the x axis
    /// is in the row left of it.
    pub fn cell_at(&self, point_body: Point) -> Option<Cell> {
        let (column, row) = self.signed_cell(point_body);
        let row = row + self.half_rows as i64;
        let inside =
            (0..self.columns as i64).contains(&column) && (0..self.rows() as i64).contains(&row);
        inside.then_some(Cell {
            column: column as usize,
            row: row as usize,
        })
    }

    /// The middle of a cell in the body frame, m.
    pub fn cell_middle(&self, cell: Cell) -> Point {
        let x_m = (cell.column as f64 + 0.5) * self.cell_m;
        Point::new(x_m, self.row_middle_m(cell.row))
    }

    /// The middle of a row, m, positive left of the car.
    fn row_middle_m(&self, row: usize) -> f64 {
        (row as f64 - self.half_rows as f64 + 0.5) * self.cell_m
    }

    /// Whether no cell that the straight line touches is occupied.
    ///
    /// Exact: row by row, the columns between where the line enters and where
    /// it leaves the row, tested a word at a time. No cell can be skipped, since
    /// no points are sampled. A cell counts as touched when the line comes
    /// within a billionth of a cell, so rounding errs to the occupied side. A
    /// line that leaves the grid is not free.
    #[inline(always)]
    pub fn is_segment_free(&self, from_body: Point, to_body: Point) -> bool {
        let bounds = Point::new(self.columns as f64, self.rows() as f64);
        let cells = |point: Point| {
            Point::new(
                point.x * self.cells_per_m,
                point.y * self.cells_per_m + self.half_rows as f64,
            )
        };
        let (from, to) = (cells(from_body), cells(to_body));
        let inside = |point: Point| {
            (0.0..=bounds.x).contains(&point.x) && (0.0..=bounds.y).contains(&point.y)
        };
        if !inside(from) || !inside(to) {
            return false;
        }
        let segment = Segment::new(from, to, self.columns - 1, self.rows() - 1);
        // The bounding box of most lines is free: it is tested first.
        self.is_rectangle_free(segment.rows(), segment.columns()) || self.is_line_free(&segment)
    }

    /// Whether the cells that a line touches are free, row by row.
    #[inline(never)]
    fn is_line_free(&self, segment: &Segment) -> bool {
        // The bounding boxes of pieces of most lines are free.
        let (first, last) = segment.rows();
        let columns_in = segment.columns_in();
        (first..=last).step_by(PIECE_ROWS).all(|row| {
            let piece = (row, last.min(row + PIECE_ROWS - 1));
            self.is_rectangle_free(piece, columns_in(piece))
                || (piece.0..=piece.1).all(|row| {
                    let (first, last) = columns_in((row, row));
                    !self.any(Run { row, first, last })
                })
        })
    }

    /// Puts rows together before a search, up to a distance ahead, m.
    #[cfg(feature = "std")]
    pub(crate) fn level(&mut self, x_max_m: f64) {
        let columns = ((x_max_m * self.cells_per_m) as usize + 2).min(self.columns);
        let rows = self.rows();
        self.levels.fill(&self.words, rows, columns.div_ceil(WORD));
    }

    /// Whether the cells of some rows and columns, first to last, are free.
    #[inline(always)]
    fn is_rectangle_free(&self, rows: (usize, usize), columns: (usize, usize)) -> bool {
        #[cfg(feature = "std")]
        if let Some(is_free) = self
            .levels
            .is_free(&self.words, self.rows(), (rows, columns))
        {
            return is_free;
        }
        self.is_each_row_free(rows, columns)
    }

    /// The same, row by row.
    #[inline(never)]
    fn is_each_row_free(&self, rows: (usize, usize), columns: (usize, usize)) -> bool {
        let all_rows = self.rows();
        words_of(columns.0, columns.1).all(|(word, mask)| {
            let words = &self.words[word * all_rows..][rows.0..=rows.1];
            together(words) & mask == 0
        })
    }
}

/// What is occupied in any of some words.
fn together(words: &[u64]) -> u64 {
    words.iter().fold(0, |all, word| all | word)
}

/// The words of a row that hold some columns, and the columns' bits in each.
fn words_of(first: usize, last: usize) -> impl Iterator<Item = (usize, u64)> {
    let (head, tail) = (first / WORD, last / WORD);
    (head..=tail).map(move |word| {
        let from_first = if word == head { from_column(first) } else { !0 };
        let to_last = if word == tail { to_column(last) } else { !0 };
        (word, from_first & to_last)
    })
}

/// The bits of a word from this column on.
fn from_column(column: usize) -> u64 {
    !0 << (column % WORD)
}

/// The bits of a word up to this column.
fn to_column(column: usize) -> u64 {
    !0 >> (WORD - 1 - column % WORD)
}
