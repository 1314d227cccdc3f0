//! The lidar: beams evenly spaced over the full circle, the first along the
//! heading, counter-clockwise; exact distances to boxes and discs.
//!
//! Only the beams that can meet a body are tested against it: those within
//! the angle that the circle around the body fills.

use std::f64::consts::TAU;

use vehicle::{Footprint, Point, Vector};

use crate::contact::{Placed, Shape};

/// Height of the beams above the ground, m; a body that lies completely above or below
/// is not hit.
pub const BEAM_HEIGHT_M: f64 = 1.2;

/// The directions and reach of the beams.
#[derive(Clone, Debug, PartialEq)]
pub struct Lidar {
    /// Unit vectors of the beams in the body frame.
    beams_body: Vec<Vector>,
    range_m: f64,
}

/// Where a scan is made from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Origin {
    /// Where all beams begin.
    pub position_world: Point,
    /// Unit vector of the first beam.
    pub forward_world: Vector,
}

impl Lidar {
    /// `beam_count` beams that reach `range_m`.
    pub fn new(beam_count: usize, range_m: f64) -> Lidar {
        let beams_body = (0..beam_count)
            .map(|k| {
                let (sin, cos) = (k as f64 * TAU / beam_count as f64).sin_cos();
                Vector::new(cos, sin)
            })
            .collect();
        Lidar {
            beams_body,
            range_m,
        }
    }

    /// Number of beams.
    pub fn beam_count(&self) -> usize {
        self.beams_body.len()
    }

    /// Reach of a beam, m.
    pub fn range_m(&self) -> f64 {
        self.range_m
    }

    /// Fills one entry of `ranges_m` for each beam with the distance to the nearest
    /// body, m; the lidar's range where there is none.
    pub fn scan(
        &self,
        origin: &Origin,
        bodies: impl Iterator<Item = Placed>,
        ranges_m: &mut [f32],
    ) {
        let count = self.beams_body.len().min(ranges_m.len());
        let ranges_m = &mut ranges_m[..count];
        ranges_m.fill(self.range_m as f32);
        for body in bodies {
            self.meet(origin, &body, ranges_m);
        }
    }

    fn meet(&self, origin: &Origin, body: &Placed, ranges_m: &mut [f32]) {
        let to_body = body.center_world - origin.position_world;
        let radius_m = body.shape.radius_m();
        let square = to_body.norm_squared();
        if square > (self.range_m + radius_m).powi(2) {
            return;
        }
        let from_body = body.to_body(-to_body);
        let turn = body.to_body(origin.forward_world);
        let shoot = |beams_body: &[Vector], ranges_m: &mut [f32]| {
            for (beam, range_m) in beams_body.iter().zip(ranges_m) {
                let along = Vector::new(
                    turn.x * beam.x - turn.y * beam.y,
                    turn.y * beam.x + turn.x * beam.y,
                );
                if let Some(hit_m) = hit_m(&body.shape, from_body, along) {
                    *range_m = range_m.min(hit_m as f32);
                }
            }
        };
        if square <= radius_m * radius_m {
            return shoot(&self.beams_body, ranges_m);
        }
        let ahead = origin.forward_world;
        let bearing_rad = ahead.perp(&to_body).atan2(ahead.dot(&to_body));
        let span_rad = (radius_m / square.sqrt()).asin();
        let spacing_rad = TAU / self.beams_body.len() as f64;
        let count = ranges_m.len() as i64;
        // One beam more on either side covers the rounding of the division.
        let first = ((bearing_rad - span_rad) / spacing_rad).floor() as i64;
        let last = ((bearing_rad + span_rad) / spacing_rad).ceil() as i64;
        if last - first + 1 >= count {
            return shoot(&self.beams_body, ranges_m);
        }
        let (begin, end) = (first.rem_euclid(count), last.rem_euclid(count) + 1);
        let (begin, end) = (begin as usize, end as usize);
        if begin < end {
            shoot(&self.beams_body[begin..end], &mut ranges_m[begin..end]);
        } else {
            shoot(
                &self.beams_body[begin..count as usize],
                &mut ranges_m[begin..],
            );
            shoot(&self.beams_body[..end], &mut ranges_m[..end]);
        }
    }
}

/// Distance along a unit vector from a point to a shape's edge, both in the
/// shape's frame; 0 from inside.
fn hit_m(shape: &Shape, from: Vector, along: Vector) -> Option<f64> {
    match shape {
        Shape::Box(Footprint { length_m, width_m }) => {
            let (near_x, far_x) = slab(from.x, along.x, length_m / 2.0);
            let (near_y, far_y) = slab(from.y, along.y, width_m / 2.0);
            let (near, far) = (near_x.max(near_y), far_x.min(far_y));
            (near <= far && far >= 0.0).then_some(near.max(0.0))
        }
        Shape::Disc { radius_m } => {
            let closing = -from.dot(&along);
            let inside = radius_m * radius_m - from.norm_squared();
            let root = closing * closing + inside;
            if root < 0.0 || (closing < 0.0 && inside < 0.0) {
                return None;
            }
            Some((closing - root.sqrt()).max(0.0))
        }
    }
}

/// Where a line enters and leaves the strip between -half and half.
fn slab(from: f64, along: f64, half: f64) -> (f64, f64) {
    // A line along the strip never crosses its edges: division by zero gives
    // infinities of the right sign, except on the edge itself.
    let (a, b) = ((-half - from) / along, (half - from) / along);
    if a.is_nan() || b.is_nan() {
        return (f64::NEG_INFINITY, f64::INFINITY);
    }
    (a.min(b), a.max(b))
}
