#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Extent, Point, Sight, Vector};

use super::{Grid, WORD, from_column, to_column};
use shm_config::settings::planner::CELLS_MAX;

/// A half-plane: what is at most `beyond_m` behind the line through a point, along the
/// line's normal.
struct Half {
    normal: Vector,
    beyond_m: f64,
}

/// The part of a row inside of some half-planes through a point, m along x, first to last;
/// the last may be less than the first.
fn part_of_row(halves: &[Half], through: Point, y_m: f64) -> [f64; 2] {
    let y_m = y_m - through.y;
    let (mut first_m, mut last_m) = (f64::NEG_INFINITY, f64::INFINITY);
    for Half { normal, beyond_m } in halves {
        // a x + b >= 0.
        let (a, b) = (normal.x, normal.y * y_m + beyond_m);
        match a {
            a if a > 0.0 => first_m = first_m.max(-b / a),
            a if a < 0.0 => last_m = last_m.min(-b / a),
            _ if b < 0.0 => return [0.0, -1.0],
            _ => {}
        }
    }
    [first_m + through.x, last_m + through.x]
}

/// Some columns of a row.
#[derive(Clone, Copy)]
struct Columns([u64; CELLS_MAX / WORD]);

impl Columns {
    const NONE: Self = Self([0; CELLS_MAX / WORD]);

    /// Adds the columns from first to last, of those that there are.
    fn add(&mut self, first: i64, last: i64) {
        let first = first.max(0);
        let last = last.min(CELLS_MAX as i64 - 1);
        if first > last {
            return;
        }
        let (first, last) = (first as usize, last as usize);
        for word in first / WORD..=last / WORD {
            let from = if word == first / WORD {
                from_column(first)
            } else {
                !0
            };
            let to = if word == last / WORD {
                to_column(last)
            } else {
                !0
            };
            self.0[word] |= from & to;
        }
    }
}

impl Grid {
    /// Marks the cells ahead of the front bumper at which the front of the body, without a
    /// turn, would be where no beam looks: nothing says that they are free. What is beside
    /// the body was ahead of it before; a turn of a long car would be blocked there.
    pub(super) fn mark_unseen(&mut self) {
        let Some(sight) = self.beams.sight() else {
            return;
        };
        let mount = sight.fan().mount_body;
        let farthest = Vector::new(
            self.x_max_m() + mount.x.abs(),
            self.y_max_m() + mount.y.abs(),
        );
        let has_no_gap = sight.has_no_gap(farthest.norm(), self.footprint.width_m);
        if has_no_gap && sight.extent() == Extent::All {
            return;
        }
        // The corners of the front, a cell less: a scanner that sees just what is ahead of
        // them sees a way.
        let beside = self.footprint.width_m / 2.0 * self.cells_per_m - 1.0;
        let beside = beside.max(0.0) as usize;
        let bumper = (self.footprint.length_m / 2.0 * self.cells_per_m).ceil() as i64;
        let mut ahead = Columns::NONE;
        ahead.add(bumper, self.columns as i64 - 1);
        let rows = self.rows();
        for row in 0..rows {
            let seen = self.seen(&sight, has_no_gap, self.row_middle_m(row));
            for word in 0..self.columns.div_ceil(WORD) {
                let unseen = ahead.0[word] & !seen.0[word];
                if unseen == 0 {
                    continue;
                }
                for near in row.saturating_sub(beside)..=(row + beside).min(rows - 1) {
                    self.words[word * rows + near] |= unseen;
                }
            }
        }
    }

    /// The columns of a row whose middle is seen.
    fn seen(&self, sight: &Sight, has_no_gap: bool, y_m: f64) -> Columns {
        let mut within = self.in_view(sight, y_m);
        if has_no_gap {
            return within;
        }
        let mount = sight.fan().mount_body;
        let mut beside = Columns::NONE;
        for &along in self.beams.directions_body() {
            let left = Vector::new(-along.y, along.x);
            let strip = [
                (along, 0.0),
                (left, self.footprint.width_m),
                (-left, self.footprint.width_m),
            ]
            .map(|(normal, beyond_m)| Half { normal, beyond_m });
            let [first, last] = self.columns_of(part_of_row(&strip, mount, y_m));
            beside.add(first, last);
        }
        for (within, beside) in within.0.iter_mut().zip(beside.0) {
            *within &= beside;
        }
        within
    }

    /// The columns of a row whose middle is in the field of view.
    fn in_view(&self, sight: &Sight, y_m: f64) -> Columns {
        let mount = sight.fan().mount_body;
        let [right, left] = sight.limits_body();
        // Left of the right limit, and right of the left one.
        let inside = [Vector::new(-right.y, right.x), Vector::new(left.y, -left.x)];
        let all = CELLS_MAX as i64 - 1;
        let mut columns = Columns::NONE;
        match sight.extent() {
            Extent::Nothing => {}
            Extent::All => columns.add(0, all),
            Extent::Narrow => {
                let halves = inside.map(|normal| Half {
                    normal,
                    beyond_m: 0.0,
                });
                let [first, last] = self.columns_of(part_of_row(&halves, mount, y_m));
                columns.add(first, last);
            }
            // More than half a turn is no intersection of half-planes; the rest of the
            // circle is.
            Extent::Wide => {
                let halves = inside.map(|normal| Half {
                    normal: -normal,
                    beyond_m: 0.0,
                });
                let [first, last] = self.columns_of(part_of_row(&halves, mount, y_m));
                match first <= last {
                    true => {
                        columns.add(0, first.saturating_sub(1));
                        columns.add(last.saturating_add(1), all);
                    }
                    false => columns.add(0, all),
                }
            }
        }
        columns
    }

    /// The columns whose middle is in a part of a row; the conversion of infinities
    /// saturates.
    fn columns_of(&self, [first_m, last_m]: [f64; 2]) -> [i64; 2] {
        [
            (first_m * self.cells_per_m - 0.5).ceil() as i64,
            (last_m * self.cells_per_m - 0.5).floor() as i64,
        ]
    }
}
