//! Bodies on the ground: their shapes, their overlaps, and the effect of a collision on
//! the cars.
//!
//! Every body is a rectangle or a disc seen from above. Heights do not matter, because
//! all of MetaDrive's bodies reach from the bumper up. Cars that overlap get the
//! impulse that ends their approach (inelastic, with Coulomb friction as Bullet
//! combines it) and are pushed apart over a few sub-steps, so that no car drives
//! through another. Cones, warning triangles and barriers only record that they are
//! touched: in the simulator cars pass through them at full speed (measured in a dozen
//! recorded drives).

use nalgebra::Rotation2;
use vehicle::{Footprint, Point, Pose, Vector};

use crate::dynamics::{Car, Motion};

/// Friction of two bodies: the product of Bullet's defaults.
const FRICTION: f64 = 0.25;
/// Share of an overlap that is removed in one sub-step (Bullet's `erp`).
const PUSH_OUT: f64 = 0.2;

/// The shape of a body seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A rectangle around the body's origin.
    Box(Footprint),
    /// A circle around it.
    Disc {
        /// Its radius, m.
        radius_m: f64,
    },
}

impl Shape {
    /// Radius of the circle around the shape, m.
    pub fn radius_m(&self) -> f64 {
        match self {
            Shape::Box(footprint) => footprint.radius_m(),
            Shape::Disc { radius_m } => *radius_m,
        }
    }
}

/// A shape at a place. `forward_world` is the unit vector along its x axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Its shape.
    pub shape: Shape,
    /// Its origin.
    pub center_world: Point,
    /// Where its x axis points.
    pub forward_world: Vector,
}

impl Placed {
    /// The rectangle of a car for contacts and beams.
    pub fn car(car: &Car, motion: &Motion) -> Placed {
        Placed {
            shape: Shape::Box(Footprint {
                length_m: car.model.length_m,
                width_m: car.model.width_m,
            }),
            center_world: motion.body_position(),
            forward_world: motion.body_forward(),
        }
    }

    /// The corners of its box, or of the box around its disc.
    pub fn corners_world(&self) -> [Point; 4] {
        let (half_x_m, half_y_m) = match self.shape {
            Shape::Box(Footprint { length_m, width_m }) => (length_m / 2.0, width_m / 2.0),
            Shape::Disc { radius_m } => (radius_m, radius_m),
        };
        let (ahead, left) = (self.forward_world * half_x_m, self.left_world() * half_y_m);
        let center = self.center_world;
        [
            center + ahead + left,
            center - ahead + left,
            center - ahead - left,
            center + ahead - left,
        ]
    }

    /// Its pose.
    pub fn pose(&self) -> Pose {
        let heading_rad = self.forward_world.y.atan2(self.forward_world.x);
        Pose::from_parts(
            self.center_world.coords.into(),
            Rotation2::new(heading_rad).into(),
        )
    }

    /// A vector of the world in the axes of the body.
    pub(crate) fn to_body(self, vector_world: Vector) -> Vector {
        Vector::new(
            self.forward_world.dot(&vector_world),
            self.forward_world.perp(&vector_world),
        )
    }

    fn left_world(&self) -> Vector {
        Vector::new(-self.forward_world.y, self.forward_world.x)
    }

    /// Half the extent along a unit vector, m.
    fn reach_m(&self, axis_world: &Vector) -> f64 {
        match self.shape {
            Shape::Box(Footprint { length_m, width_m }) => {
                self.forward_world.dot(axis_world).abs() * length_m / 2.0
                    + self.left_world().dot(axis_world).abs() * width_m / 2.0
            }
            Shape::Disc { radius_m } => radius_m,
        }
    }

    /// The point of the shape nearest to another point; inside the shape, that point
    /// itself.
    fn nearest(&self, point_world: Point) -> Point {
        let away = point_world - self.center_world;
        match self.shape {
            Shape::Box(Footprint { length_m, width_m }) => {
                let body = self.to_body(away);
                let x_m = body.x.clamp(-length_m / 2.0, length_m / 2.0);
                let y_m = body.y.clamp(-width_m / 2.0, width_m / 2.0);
                self.center_world + self.forward_world * x_m + self.left_world() * y_m
            }
            Shape::Disc { radius_m } => {
                let distance_m = away.norm().max(radius_m).max(f64::MIN_POSITIVE);
                self.center_world + away * (radius_m / distance_m).min(1.0)
            }
        }
    }
}

/// How two bodies overlap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overlap {
    /// Unit vector from the second body to the first, along which the overlap is
    /// shortest.
    pub normal_world: Vector,
    /// Length of the overlap along it, m.
    pub depth_m: f64,
    /// A point inside both.
    pub at_world: Point,
}

/// The overlap of two bodies, or `None` when they are apart. Separating axes:
/// the sides of the boxes, and for a disc the line to the box's nearest point.
pub fn overlap(first: &Placed, second: &Placed) -> Option<Overlap> {
    let between = first.center_world - second.center_world;
    let reach_m = first.shape.radius_m() + second.shape.radius_m();
    if between.norm_squared() > reach_m * reach_m {
        return None;
    }
    let mut least: Option<(f64, Vector)> = None;
    for axis in axes(first, second) {
        let distance_m = between.dot(&axis);
        let depth_m = first.reach_m(&axis) + second.reach_m(&axis) - distance_m.abs();
        if depth_m < 0.0 {
            return None;
        }
        if least.is_none_or(|(known_m, _)| depth_m < known_m) {
            least = Some((depth_m, axis * distance_m.signum()));
        }
    }
    let (depth_m, normal_world) = least?;
    Some(Overlap {
        normal_world,
        depth_m,
        at_world: middle(first, second),
    })
}

fn axes(first: &Placed, second: &Placed) -> impl Iterator<Item = Vector> {
    let of = |body: &Placed, other: &Placed| match body.shape {
        Shape::Box(_) => [Some(body.forward_world), Some(body.left_world())],
        Shape::Disc { .. } => {
            let away = body.center_world - other.nearest(body.center_world);
            [
                Some(away.try_normalize(1e-9).unwrap_or(body.forward_world)),
                None,
            ]
        }
    };
    of(first, second)
        .into_iter()
        .chain(of(second, first))
        .flatten()
}

/// A point in the middle of the overlap: the midpoint of each body's point nearest to
/// the other's centre, refined once.
fn middle(first: &Placed, second: &Placed) -> Point {
    let on_first = first.nearest(second.center_world);
    let on_second = second.nearest(on_first);
    let on_first = first.nearest(on_second);
    nalgebra::center(&on_first, &on_second)
}

/// A car in a collision: the car and its motion.
pub type Party<'a> = (&'a Car, &'a mut Motion);

/// Ends the approach of two overlapping cars and begins to part them.
pub fn collide(first: Party, second: Party, overlap: &Overlap) {
    let Overlap {
        normal_world: normal,
        depth_m,
        at_world: at,
    } = *overlap;
    let ((first_car, first), (second_car, second)) = (first, second);
    let slip = first.velocity_at(at) - second.velocity_at(at);
    let mobility = |first: &Motion, second: &Motion, along: Vector| {
        first_car.planar_mobility(first, at, along) + second_car.planar_mobility(second, at, along)
    };
    let approach_mps = -slip.dot(&normal);
    if approach_mps > 0.0 {
        let push_ns = approach_mps / mobility(first, second, normal);
        let tangent = Vector::new(-normal.y, normal.x);
        let stop_ns = -slip.dot(&tangent) / mobility(first, second, tangent);
        let rub_ns = stop_ns.clamp(-FRICTION * push_ns, FRICTION * push_ns);
        let impulse = normal * push_ns + tangent * rub_ns;
        first_car.shove(first, impulse, at);
        second_car.shove(second, -impulse, at);
    }
    let out = normal * (depth_m * PUSH_OUT / 2.0);
    first.displace(out);
    second.displace(-out);
}
