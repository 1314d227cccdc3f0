//! Combines the occupied cells of a grid into few rectangles.

use std::fmt::Write;

use planner::{Cell, Grid};

/// Columns `first..end` of a row.
type Run = (usize, usize);

/// The occupied cells as SVG path data, one unit per cell: x counts columns, y counts rows
/// downwards from the leftmost row in the car's view.
///
/// Runs with the same begin and end in neighbouring rows become one rectangle.
pub(super) fn occupied(grid: &Grid) -> String {
    let mut data = String::new();
    let mut open: Vec<(Run, usize)> = Vec::new();
    for line in 0..=grid.rows() {
        let now = match line < grid.rows() {
            true => runs(grid, grid.rows() - 1 - line),
            false => Vec::new(),
        };
        open.retain(|&((first, end), top)| {
            let goes_on = now.contains(&(first, end));
            if !goes_on {
                let (width, height) = (end - first, line - top);
                // Writing to a string cannot fail.
                let _ = write!(data, "M{first} {top}h{width}v{height}h-{width}z");
            }
            goes_on
        });
        for run in now {
            if !open.iter().any(|&(known, _)| known == run) {
                open.push((run, line));
            }
        }
    }
    data
}

/// The occupied runs of a row.
fn runs(grid: &Grid, row: usize) -> Vec<Run> {
    let mut runs = Vec::new();
    let mut begun = None;
    for column in 0..=grid.columns() {
        let inside = column < grid.columns() && grid.is_occupied(Cell { column, row });
        match (begun, inside) {
            (None, true) => begun = Some(column),
            (Some(first), false) => {
                runs.push((first, column));
                begun = None;
            }
            (None, false) | (Some(_), true) => {}
        }
    }
    runs
}
