//! What a bucket holds, and what is known of it.

use vehicle::Point;

use super::NONE;
use super::lanes::{LANES, more};

/// Nodes of one bucket. Lanes after the last node are infinitely far away.
#[derive(Debug, Clone, Copy)]
// A vector of 256 bits never lies in two lines of the cache.
#[repr(align(32))]
pub(super) struct Block {
    pub(super) x_m: [f64; LANES],
    pub(super) y_m: [f64; LANES],
    pub(super) cost_m: [f64; LANES],
    /// As numbers of the same width, which vector instructions compare together.
    pub(super) index: [f64; LANES],
    /// The next block of the bucket.
    pub(super) next: u16,
    pub(super) bucket: u16,
}

impl Block {
    /// Squared distances to a point, m².
    #[inline(always)]
    pub(super) fn squares(&self, point_body: Point) -> [f64; LANES] {
        let mut squares = [0.0; LANES];
        for (lane, square) in squares.iter_mut().enumerate() {
            let (dx_m, dy_m) = (self.x_m[lane] - point_body.x, self.y_m[lane] - point_body.y);
            *square = dx_m * dx_m + dy_m * dy_m;
        }
        squares
    }
}

/// The bounds of some buckets: of the places of their nodes, and of the costs.
#[derive(Debug, Clone, Copy)]
// As a block.
#[repr(align(32))]
pub(super) struct Group {
    pub(super) low_x_m: [f64; LANES],
    pub(super) high_x_m: [f64; LANES],
    pub(super) low_y_m: [f64; LANES],
    pub(super) high_y_m: [f64; LANES],
    /// The least cost.
    pub(super) least_m: [f64; LANES],
    /// At least the greatest cost.
    pub(super) most_m: [f64; LANES],
    /// Squared distances to the point that was measured last, m².
    pub(super) squares: [f64; LANES],
    pub(super) first: [u16; LANES],
    pub(super) last: [u16; LANES],
    /// Nodes in the last block.
    pub(super) filled: [u16; LANES],
}

impl Group {
    pub(super) const EMPTY: Self = Self {
        low_x_m: [f64::INFINITY; LANES],
        high_x_m: [f64::NEG_INFINITY; LANES],
        low_y_m: [f64::INFINITY; LANES],
        high_y_m: [f64::NEG_INFINITY; LANES],
        least_m: [f64::INFINITY; LANES],
        most_m: [f64::NEG_INFINITY; LANES],
        squares: [f64::INFINITY; LANES],
        first: [NONE; LANES],
        last: [NONE; LANES],
        filled: [LANES as u16; LANES],
    };

    #[inline(always)]
    pub(super) fn measure(&mut self, point_body: Point) {
        for lane in 0..LANES {
            let apart =
                |low_m: f64, high_m: f64, at_m: f64| more(more(low_m - at_m, at_m - high_m), 0.0);
            let dx_m = apart(self.low_x_m[lane], self.high_x_m[lane], point_body.x);
            let dy_m = apart(self.low_y_m[lane], self.high_y_m[lane], point_body.y);
            self.squares[lane] = dx_m * dx_m + dy_m * dy_m;
        }
    }
}
