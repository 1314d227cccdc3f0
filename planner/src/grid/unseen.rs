use shm_config::message::Observation;
#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Fan, Point, Vector};

use super::Grid;

/// Two half-planes through the mount of a scanner: a wedge of at most half a turn.
struct Wedge {
    mount_body: Point,
    /// Unit vectors along its right and its left limit.
    limits_body: [Vector; 2],
}

impl Wedge {
    /// Between two angles, rad, the second at most half a turn left of the first.
    fn new(fan: &Fan, right_rad: f64, left_rad: f64) -> Self {
        let along = |angle_rad: f64| {
            let (sin, cos) = angle_rad.sin_cos();
            Vector::new(cos, sin)
        };
        Self {
            mount_body: fan.mount_body,
            limits_body: [along(right_rad), along(left_rad)],
        }
    }

    /// The part of a row inside, m along x, first to last; the last may be less than
    /// the first.
    fn part_of_row(&self, y_m: f64) -> [f64; 2] {
        let y_m = y_m - self.mount_body.y;
        let [right, left] = self.limits_body;
        let (mut first_m, mut last_m) = (f64::NEG_INFINITY, f64::INFINITY);
        // Left of the right limit, and right of the left one: each a x + b >= 0.
        for (a, b) in [(-right.y, right.x * y_m), (left.y, -left.x * y_m)] {
            match a {
                a if a > 0.0 => first_m = first_m.max(-b / a),
                a if a < 0.0 => last_m = last_m.min(-b / a),
                _ if b < 0.0 => return [0.0, -1.0],
                _ => {}
            }
        }
        [first_m + self.mount_body.x, last_m + self.mount_body.x]
    }
}

impl Grid {
    /// Marks the cells ahead of the front bumper at which no beam looks: nothing says that
    /// they are free. What is beside the body was ahead of it before; a turn of a long car
    /// would be blocked there.
    pub(super) fn mark_unseen(&mut self, observation: &Observation) {
        let fan = observation.fan();
        if fan.covers_all() {
            return;
        }
        let last_column = self.columns as i64 - 1;
        if fan.beams == 0 {
            for row in 0..self.rows() {
                self.mark_ahead(row, 0, last_column);
            }
            return;
        }
        let half_rad = fan.seen_half_rad();
        if half_rad >= core::f64::consts::PI {
            return;
        }
        let (right_rad, left_rad) = (fan.heading_rad - half_rad, fan.heading_rad + half_rad);
        // A wedge of more than half a turn is no intersection of half-planes; the rest of
        // the circle then is.
        let sees_half = half_rad > core::f64::consts::FRAC_PI_2;
        let wedge = match sees_half {
            true => Wedge::new(&fan, left_rad, right_rad),
            false => Wedge::new(&fan, right_rad, left_rad),
        };
        for row in 0..self.rows() {
            let [first_m, last_m] = wedge.part_of_row(self.row_middle_m(row));
            // Columns whose middle is inside; the conversion of infinities saturates.
            let first = (first_m * self.cells_per_m - 0.5).ceil() as i64;
            let last = (last_m * self.cells_per_m - 0.5).floor() as i64;
            match (sees_half, first <= last) {
                (true, true) => self.mark_ahead(row, first, last),
                (true, false) => {}
                (false, true) => {
                    self.mark_ahead(row, 0, first.saturating_sub(1));
                    self.mark_ahead(row, last.saturating_add(1), last_column);
                }
                (false, false) => self.mark_ahead(row, 0, last_column),
            }
        }
    }

    /// Marks some columns of a row, as far as they are ahead of the front bumper.
    fn mark_ahead(&mut self, row: usize, first: i64, last: i64) {
        let bumper = (self.footprint.length_m / 2.0 * self.cells_per_m).ceil() as i64;
        let first = first.max(bumper);
        if first <= last {
            self.mark(row, first, last);
        }
    }
}
