use shm_config::message::{Bend, Observation};
#[allow(unused_imports)]
use vehicle::Float as _;
use vehicle::Point;

/// The road's edges near the car, in the body frame: two straight lines or two
/// concentric arcs, from the measured distances, heading and bend.
///
/// It holds up to the next checkpoint, where the bend may change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoadAhead {
    left_m: f64,
    right_m: f64,
    sin: f64,
    cos: f64,
    shape: Shape,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Shape {
    Straight,
    /// `centre_y_m`: lateral position of the bend's centre in the road frame at
    /// the car, positive left.
    Arc {
        centre_y_m: f64,
    },
}

impl RoadAhead {
    /// The road of an observation.
    pub fn new(observation: &Observation) -> Self {
        let road = &observation.road;
        let checkpoint = &observation.checkpoints[0];
        // The radius is that of the leftmost lane's centre line, half a lane from the
        // left edge.
        let to_leftmost_m = road.left_m - road.lane_width_m / 2.0;
        let shape = match checkpoint.bend() {
            Bend::Straight => Shape::Straight,
            Bend::Left => Shape::Arc {
                centre_y_m: to_leftmost_m + checkpoint.bend_radius_m,
            },
            Bend::Right => Shape::Arc {
                centre_y_m: to_leftmost_m - checkpoint.bend_radius_m,
            },
        };
        // A centre nearer than this is not a bend a car can follow.
        let shape = match shape {
            Shape::Arc { centre_y_m } if centre_y_m.abs() < 1.0 => Shape::Straight,
            shape => shape,
        };
        let (sin, cos) = road.heading_rad.sin_cos();
        Self {
            left_m: road.left_m,
            right_m: road.right_m,
            sin,
            cos,
            shape,
        }
    }

    /// Offset of a point from the car's track along the road, m, positive left.
    pub fn offset_m(&self, point_body: Point) -> f64 {
        let x_road_m = self.cos * point_body.x - self.sin * point_body.y;
        let y_road_m = self.sin * point_body.x + self.cos * point_body.y;
        match self.shape {
            Shape::Straight => y_road_m,
            Shape::Arc { centre_y_m } => {
                let radius_m = x_road_m.hypot(y_road_m - centre_y_m);
                (centre_y_m.abs() - radius_m) * centre_y_m.signum()
            }
        }
    }

    /// Distance from a point to the nearer edge, m; negative beyond it.
    pub fn edge_m(&self, point_body: Point) -> f64 {
        let offset_m = self.offset_m(point_body);
        (self.left_m - offset_m).min(self.right_m + offset_m)
    }
}
