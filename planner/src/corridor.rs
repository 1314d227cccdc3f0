use shm_config::message::Road;

/// A band of the body frame along x: the lane corridor of Sec. 4.1.1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corridor {
    /// Its right edge, m, positive left of the car: `y_right`.
    pub right_m: f64,
    /// Its left edge, m, positive left of the car: `y_left`; not less than the right one.
    pub left_m: f64,
}

impl Corridor {
    /// The road shrunk by the margin, `[-d_right + m, d_left - m]`, limited to
    /// the grid's `y_max_m`.
    ///
    /// A road narrower than two margins leaves its middle line.
    pub fn lane(road: &Road, margin_m: f64, y_max_m: f64) -> Self {
        let left_m = road.left_m - margin_m;
        let right_m = margin_m - road.right_m;
        let middle_m = (road.left_m - road.right_m) / 2.0;
        // Not `clamp`, which would keep what is not a number.
        let limited = |y_m: f64| y_m.max(-y_max_m).min(y_max_m);
        let right_m = limited(right_m.min(middle_m));
        Self {
            right_m,
            left_m: limited(left_m.max(middle_m)).max(right_m),
        }
    }

    /// This corridor widened so that the row of cells on either side of the
    /// x axis is inside.
    ///
    /// The car stands at the origin, inside the corridor or not. A car that has left the
    /// margin may still drive: the road between car and corridor is as free as at the
    /// car, and the goal, which stays inside the corridor, leads back.
    pub fn with_start(self, cell_m: f64) -> Self {
        Self {
            right_m: self.right_m.min(-cell_m),
            left_m: self.left_m.max(cell_m),
        }
    }
}
