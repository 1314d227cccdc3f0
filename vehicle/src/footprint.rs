#[cfg(not(feature = "std"))]
use crate::Float as _;
use crate::{Point, Pose};

/// The rectangle a car covers, centred on its body frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Footprint {
    /// Along x, m.
    pub length_m: f64,
    /// Along y, m.
    pub width_m: f64,
}

impl Footprint {
    /// The corners in the frame that `frame_from_body` maps to, counter-clockwise
    /// from front left.
    pub fn corners(&self, frame_from_body: &Pose) -> [Point; 4] {
        let (half_length_m, half_width_m) = (self.length_m / 2.0, self.width_m / 2.0);
        [
            Point::new(half_length_m, half_width_m),
            Point::new(-half_length_m, half_width_m),
            Point::new(-half_length_m, -half_width_m),
            Point::new(half_length_m, -half_width_m),
        ]
        .map(|corner_body| frame_from_body * corner_body)
    }

    /// Signed distance from the rectangle's edge to a point of the body frame,
    /// m: negative inside.
    pub fn distance_m(&self, point_body: Point) -> f64 {
        let dx_m = point_body.x.abs() - self.length_m / 2.0;
        let dy_m = point_body.y.abs() - self.width_m / 2.0;
        dx_m.max(0.0).hypot(dy_m.max(0.0)) + dx_m.max(dy_m).min(0.0)
    }

    /// Radius of the circle around the corners, m.
    pub fn radius_m(&self) -> f64 {
        self.length_m.hypot(self.width_m) / 2.0
    }
}
