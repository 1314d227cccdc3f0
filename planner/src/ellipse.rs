#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Point, Vector};

use crate::sampler::{Region, Sampler};

/// Draws from the ellipse that may fall outside the region before one is drawn
/// from the region itself.
const DRAWS: usize = 16;

/// The points a path from the origin to a goal can pass and still be no longer
/// than a given length: an ellipse with both as its foci (Gammell, Srinivasa &
/// Barfoot, *Informed RRT\**, 2014, Sec. III).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ellipse {
    middle: Point,
    /// Half of the long axis and of the short one, m, in the body frame.
    long: Vector,
    short: Vector,
}

impl Ellipse {
    /// Of the paths of at most this length, m; a length less than the straight
    /// line is that.
    pub(crate) fn new(goal_body: Point, length_m: f64) -> Self {
        let straight_m = goal_body.coords.norm();
        let direction = match straight_m > 0.0 {
            true => goal_body.coords / straight_m,
            false => Vector::x(),
        };
        let long_m = length_m.max(straight_m) / 2.0;
        let short_m = (long_m * long_m - straight_m * straight_m / 4.0)
            .max(0.0)
            .sqrt();
        Self {
            middle: Point::from(goal_body.coords / 2.0),
            long: direction * long_m,
            short: Vector::new(-direction.y, direction.x) * short_m,
        }
    }

    /// Uniform in what the ellipse and the region share. When none of the first
    /// draws from the ellipse is in the region, uniform in the region.
    pub(crate) fn point_body(&self, region: &Region, sampler: &mut Sampler) -> Point {
        for _ in 0..DRAWS {
            // Uniform in the unit disc: the root corrects for the growing circumference.
            let radius = sampler.unit().sqrt();
            let (sin, cos) = (core::f64::consts::TAU * sampler.unit()).sin_cos();
            let point = self.middle + (self.long * cos + self.short * sin) * radius;
            let inside = (0.0..=region.x_max_m).contains(&point.x)
                && (region.right_m..=region.left_m).contains(&point.y);
            if inside {
                return point;
            }
        }
        sampler.point_body(region)
    }
}
