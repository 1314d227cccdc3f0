use shm_config::message::Observation;
#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::Point;

use super::{Grid, STARTS_MAX, words_of};
use crate::centre_line::CentreLine;
use crate::corridor::Corridor;

/// The road begins this far behind the car, m: the whole body is on it.
const BEHIND_M: f64 = 3.0;
/// In a bend, the road is drawn in pieces of this length, m: the chord of one
/// leaves the outer edge of the tightest bend (R = 19 m) by 7 mm.
const PIECE_M: f64 = 1.0;
/// Pieces at most; the grid ends before that.
const PIECES_MAX: usize = 128;

impl Grid {
    /// Forgets everything and marks what this observation shows, as
    /// [`Grid::fill`] does, but with the corridor bent as the road is: between
    /// the lines left and right of the middle line that are the margin inside
    /// the edges of the road.
    ///
    /// `starts_m` are the points of the body on the x axis, m ahead of its
    /// middle, that move over the grid; where they are now is never occupied,
    /// and the disc around a return is made smaller, to less than its distance
    /// from the nearest of them. At most four count.
    pub(crate) fn fill_along(
        &mut self,
        observation: &Observation,
        line: &CentreLine,
        starts_m: &[f64],
    ) {
        let lane = Corridor::lane(&observation.road, self.lane_margin_m, self.y_max_m());
        let middle_m = (observation.road.left_m - observation.road.right_m) / 2.0;
        let mut beside = Corridor {
            right_m: lane.right_m - middle_m,
            left_m: lane.left_m - middle_m,
        };
        // As `Corridor::with_start`, for each point of the body.
        for &start_m in starts_m {
            let road = line.at(start_m).body_from_road;
            let across_m = road.inverse_transform_point(&Point::new(start_m, 0.0)).y;
            beside.right_m = beside.right_m.min(across_m - 2.0 * self.cell_m);
            beside.left_m = beside.left_m.max(across_m + 2.0 * self.cell_m);
        }
        self.corridor = Corridor {
            right_m: beside.right_m + middle_m,
            left_m: beside.left_m + middle_m,
        };
        self.words.fill(!0);
        self.pave(line, beside);
        let columns = starts_m.iter().take(STARTS_MAX);
        self.starts = columns
            .map(|start_m| (start_m * self.cells_per_m).floor() as i64)
            .collect();
        self.stamp_returns(observation);
        self.mark_unseen();
        for start in 0..self.starts.len() {
            let column = self.starts[start].max(0) as usize;
            self.clear(self.half_rows, column, column);
            self.clear(self.half_rows - 1, column, column);
        }
        #[cfg(feature = "std")]
        self.levels.begin(0..self.rows());
    }

    /// Frees the road, piece by piece.
    fn pave(&mut self, line: &CentreLine, beside: Corridor) {
        let edges = |along_m: f64| {
            let road = line.at(along_m).body_from_road;
            [beside.right_m, beside.left_m].map(|across_m| road * Point::new(0.0, across_m))
        };
        let end_m = 2.0 * self.x_max_m();
        let (mut along_m, mut near) = (-BEHIND_M, edges(-BEHIND_M));
        for _ in 0..PIECES_MAX {
            let to_m = line
                .straight_until(along_m)
                .max(along_m + PIECE_M)
                .min(end_m);
            let far = edges(to_m);
            self.free_quad([near[0], far[0], far[1], near[1]]);
            if to_m >= end_m {
                return;
            }
            (along_m, near) = (to_m, far);
        }
    }

    /// Frees the cells whose middles are in a convex figure.
    fn free_quad(&mut self, corners: [Point; 4]) {
        if !corners
            .iter()
            .all(|corner| corner.x.is_finite() && corner.y.is_finite())
        {
            return;
        }
        let in_cells = |corner: Point| {
            let x = corner.x * self.cells_per_m - 0.5;
            Point::new(x, corner.y * self.cells_per_m + self.half_rows as f64 - 0.5)
        };
        let corners = corners.map(in_cells);
        let bounds = |of: fn(&Point) -> f64| {
            let values = corners.iter().map(of);
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            })
        };
        let ((left, right), (low, high)) = (bounds(|corner| corner.x), bounds(|corner| corner.y));
        // Half of the road lies beyond the grid.
        if left > self.columns as f64 || right < -1.0 {
            return;
        }
        let last = (high.floor() as i64).min(self.rows() as i64 - 1);
        for row in (low.ceil() as i64).max(0)..=last {
            let y = row as f64;
            let (mut first, mut last) = (f64::INFINITY, f64::NEG_INFINITY);
            for side in 0..4 {
                let (a, b) = (corners[side], corners[(side + 1) % 4]);
                if (a.y <= y) == (b.y <= y) && a.y != y && b.y != y {
                    continue;
                }
                let x = match a.y == b.y {
                    true => a.x,
                    false => a.x + (b.x - a.x) * ((y - a.y) / (b.y - a.y)),
                };
                (first, last) = (first.min(x), last.max(x));
            }
            // A hundred-millionth of a cell: neighbouring pieces leave no gap.
            let (first, last) = (first - 1e-8, last + 1e-8);
            if last < 0.0 || first > self.columns as f64 {
                continue;
            }
            // Truncating is floor for what is positive, at a fraction of its cost.
            let up = first.max(0.0) as usize;
            let up = up + usize::from((up as f64) < first);
            let down = (last as usize).min(self.columns - 1);
            if up <= down {
                self.clear(row as usize, up, down);
            }
        }
    }

    /// Frees the columns `first..=last` of a row of the grid.
    fn clear(&mut self, row: usize, first: usize, last: usize) {
        let rows = self.rows();
        for (word, mask) in words_of(first, last) {
            self.words[word * rows + row] &= !mask;
        }
    }
}
