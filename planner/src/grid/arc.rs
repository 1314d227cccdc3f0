use core::f64::consts::FRAC_PI_2;

#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Point, Vector};

use super::Grid;
use crate::segment::{Run, Segment, cells};

/// How near an arc must come to a cell to touch it, in cells. Where an arc of r
/// cells is level, this much in height is sqrt(2 r TOUCH) in width: a hundredth
/// of a cell at most on the road, and far more than what r² rounds by.
const TOUCH: f64 = 1e-7;

/// A part of a circle, in cells, along which x and y only rise or only fall.
struct Quarter {
    centre: Point,
    radius: f64,
    from: Point,
    to: Point,
    /// 1 on the side of the circle with the larger x.
    side: f64,
}

impl Grid {
    /// Whether no cell that an arc touches is occupied: around a centre, from a
    /// point, by so many radians, counter-clockwise.
    ///
    /// Exact as [`Grid::is_segment_free`] is: the arc is cut where it is level
    /// or upright, and of each part row by row the columns between where it
    /// enters and where it leaves the row are tested. An arc that leaves the
    /// grid is not free.
    pub fn is_arc_free(&self, centre_body: Point, from_body: Point, turn_rad: f64) -> bool {
        let centre = self.in_cells(centre_body);
        let arm = self.in_cells(from_body) - centre;
        let (radius, from_rad) = (arm.norm(), arm.y.atan2(arm.x));
        let (low_rad, high_rad) = match turn_rad < 0.0 {
            true => (from_rad + turn_rad, from_rad),
            false => (from_rad, from_rad + turn_rad),
        };
        let at = |angle_rad: f64| {
            let (sin, cos) = angle_rad.sin_cos();
            centre + Vector::new(cos, sin) * radius
        };
        let (mut begin_rad, mut begin) = (low_rad, at(low_rad));
        // A full turn has five parts at most; more than two turns are not free.
        for quadrant in (low_rad / FRAC_PI_2).floor() as i32..(low_rad / FRAC_PI_2) as i32 + 9 {
            let end_rad = (f64::from(quadrant + 1) * FRAC_PI_2).min(high_rad);
            let end = at(end_rad);
            if end_rad > begin_rad {
                let quarter = Quarter {
                    centre,
                    radius,
                    from: begin,
                    to: end,
                    side: match quadrant.rem_euclid(4) {
                        0 | 3 => 1.0,
                        _ => -1.0,
                    },
                };
                if !self.is_quarter_free(&quarter) {
                    return false;
                }
                (begin_rad, begin) = (end_rad, end);
            }
            if begin_rad >= high_rad {
                return self.cell_of(begin).is_some_and(|run| !self.any(run));
            }
        }
        high_rad <= begin_rad
    }

    fn is_quarter_free(&self, quarter: &Quarter) -> bool {
        let inside = |point: Point| {
            (0.0..=self.columns as f64).contains(&point.x)
                && (0.0..=self.rows() as f64).contains(&point.y)
        };
        if !inside(quarter.from) || !inside(quarter.to) {
            return false;
        }
        let (last_column, last_row) = (self.columns - 1, self.rows() - 1);
        let (low, high) = quarter.corners();
        let around = Segment::new(low, high, last_column, last_row);
        let (first, last) = around.rows();
        self.is_rectangle_free((first, last), around.columns())
            || (first..=last).all(|row| !self.any(quarter.run(row, last_column)))
    }

    /// The single cell of a point in cells, as a run.
    fn cell_of(&self, point: Point) -> Option<Run> {
        let inside = (0.0..=self.columns as f64).contains(&point.x)
            && (0.0..=self.rows() as f64).contains(&point.y);
        let column = (point.x as usize).min(self.columns - 1);
        inside.then(|| Run {
            row: (point.y as usize).min(self.rows() - 1),
            first: column,
            last: column,
        })
    }

    fn in_cells(&self, point_body: Point) -> Point {
        Point::new(
            point_body.x * self.cells_per_m,
            point_body.y * self.cells_per_m + self.half_rows as f64,
        )
    }
}

impl Quarter {
    /// Lower left and upper right corner of what is around it.
    fn corners(&self) -> (Point, Point) {
        let (low, high) = self.from.coords.inf_sup(&self.to.coords);
        let touch = Vector::repeat(TOUCH);
        (Point::from(low - touch), Point::from(high + touch))
    }

    /// The columns it touches in one of its rows.
    fn run(&self, row: usize, last_column: usize) -> Run {
        let (low, high) = self.from.coords.inf_sup(&self.to.coords);
        let x_at = |y: f64| {
            let up = y.max(low.y).min(high.y) - self.centre.y;
            let x =
                self.centre.x + self.side * (self.radius * self.radius - up * up).max(0.0).sqrt();
            x.max(low.x).min(high.x)
        };
        let (enter, leave) = (x_at(row as f64 - TOUCH), x_at(row as f64 + 1.0 + TOUCH));
        let (first, last) = cells(
            enter.min(leave) - TOUCH,
            enter.max(leave) + TOUCH,
            last_column,
        );
        Run { row, first, last }
    }
}
