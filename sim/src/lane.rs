//! One lane: a centre line that is straight or a circular arc, a width, and
//! the lines painted on its two sides.
//!
//! Lane coordinates follow MetaDrive: `longitudinal` runs along the lane from
//! its start, `lateral` is positive to the **right** of the driving direction
//! (the opposite of the repository's y-left axes; the name says which is
//! meant). Source: `component/lane/*.py` of MetaDrive, commit c29cc37.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::mem::offset_of;

use vehicle::{Point, Vector};

use crate::surface::{ArcSurface, Bounds};

/// How far apart MetaDrive samples a centre line for the lane's surface, m.
pub const SURFACE_STEP_M: f64 = 1.0;

/// The line painted on one side of a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineType {
    /// No line.
    None,
    /// Broken white: may be crossed.
    Broken,
    /// Solid: must not be crossed.
    Continuous,
    /// Edge of the road: a sidewalk begins 0.2 m outside it.
    Side,
}

/// The colour of the line on the left of a lane; the right one is always white.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineColor {
    /// Between lanes of the same direction.
    White,
    /// Between the two directions.
    Yellow,
}

/// Which way an arc bends, seen along the lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// Counter-clockwise.
    Left,
    /// Clockwise.
    Right,
}

impl Turn {
    /// +1 to the left (counter-clockwise), -1 to the right.
    pub fn sign(self) -> f64 {
        match self {
            Turn::Left => 1.0,
            Turn::Right => -1.0,
        }
    }

    /// The other way.
    pub fn opposite(self) -> Turn {
        match self {
            Turn::Left => Turn::Right,
            Turn::Right => Turn::Left,
        }
    }
}

/// A straight centre line.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Straight {
    /// Heading, rad, counter-clockwise from world x.
    pub heading_rad: f64,
    /// Unit vector along the lane.
    pub forward_world: Vector,
}

impl Straight {
    fn right_world(&self) -> Vector {
        Vector::new(self.forward_world.y, -self.forward_world.x)
    }
}

/// A circular centre line.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Arc {
    /// Which way it bends.
    pub turn: Turn,
    /// Centre of the circle.
    pub center_world: Point,
    /// Radius of the centre line, m, positive.
    pub radius_m: f64,
    /// Direction from the centre to the start, rad, in (-pi, pi].
    pub start_phase_rad: f64,
    /// Angle swept, rad, positive.
    pub angle_rad: f64,
    surface: ArcSurface,
}

impl Arc {
    /// Direction from the centre to the end, rad; not wrapped.
    pub fn end_phase_rad(&self) -> f64 {
        self.start_phase_rad + self.turn.sign() * self.angle_rad
    }

    /// What makes this arc.
    pub fn shape(&self) -> ArcShape {
        ArcShape {
            center_world: self.center_world,
            radius_m: self.radius_m,
            start_phase_rad: self.start_phase_rad,
            angle_rad: self.angle_rad,
            turn: self.turn,
        }
    }

    fn phase_at(&self, longitudinal_m: f64) -> f64 {
        self.turn.sign() * longitudinal_m / self.radius_m + self.start_phase_rad
    }
}

/// The shape of a lane's centre line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Curve {
    /// A straight lane.
    Straight(Straight),
    /// The short slanted lane in which a ramp's lane opens or closes;
    /// geometrically straight.
    Taper(Straight),
    /// A circular lane.
    Arc(Arc),
}

/// One lane. Everything that a step looks up is computed once, here. What the lane
/// coordinates need is first: one cache line of a straight lane, two of an arc.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Lane {
    /// Length of the centre line, m.
    pub length_m: f64,
    /// Width, m.
    pub width_m: f64,
    /// Start of the centre line.
    pub start_world: Point,
    /// Shape of the centre line.
    pub curve: Curve,
    /// End of the centre line.
    pub end_world: Point,
    /// Lines on the left and on the right.
    pub lines: [LineType; 2],
    /// Colour of the left line.
    pub left_color: LineColor,
}

/// Bytes of a lane that a tick reads.
pub(crate) const LANE_BYTES: usize = offset_of!(Lane, end_world);

const _: () = assert!(LANE_BYTES == 128, "two cache lines");

impl Lane {
    /// A straight lane from one point to another.
    pub fn straight(start_world: Point, end_world: Point, width_m: f64) -> Lane {
        let along = end_world - start_world;
        let length_m = norm(along);
        Lane {
            curve: Curve::Straight(Straight {
                heading_rad: along.y.atan2(along.x),
                forward_world: along / length_m,
            }),
            length_m,
            width_m,
            start_world,
            end_world,
            lines: [LineType::Broken; 2],
            left_color: LineColor::White,
        }
    }

    /// A slanted lane in which a ramp's lane opens or closes.
    pub fn taper(start_world: Point, end_world: Point, width_m: f64) -> Lane {
        let mut lane = Lane::straight(start_world, end_world, width_m);
        if let Curve::Straight(straight) = lane.curve {
            lane.curve = Curve::Taper(straight);
        }
        lane.lines = [LineType::None, LineType::Continuous];
        lane
    }

    /// A circular lane. `radius_m` and `angle_rad` must be positive.
    pub fn arc(shape: ArcShape, width_m: f64) -> Lane {
        let start_phase_rad = wrap_by_turns_rad(shape.start_phase_rad);
        // Through the phases, as the simulator does it: the last bits decide
        // where whole metres end.
        let end_phase_rad = start_phase_rad + shape.turn.sign() * shape.angle_rad;
        let length_m = (shape.radius_m * (end_phase_rad - start_phase_rad)).abs();
        let arc = Arc {
            center_world: shape.center_world,
            radius_m: shape.radius_m,
            start_phase_rad,
            angle_rad: shape.angle_rad,
            turn: shape.turn,
            surface: ArcSurface::new(&shape, start_phase_rad),
        };
        let mut lane = Lane {
            curve: Curve::Arc(arc),
            length_m,
            width_m,
            start_world: Point::origin(),
            end_world: Point::origin(),
            lines: [LineType::Broken; 2],
            left_color: LineColor::White,
        };
        lane.start_world = lane.position(0.0, 0.0);
        lane.end_world = lane.position(length_m, 0.0);
        lane
    }

    /// The world point at lane coordinates (m; lateral positive to the right).
    pub fn position(&self, longitudinal_m: f64, lateral_m: f64) -> Point {
        match &self.curve {
            Curve::Straight(line) | Curve::Taper(line) => {
                self.start_world
                    + longitudinal_m * line.forward_world
                    + lateral_m * line.right_world()
            }
            Curve::Arc(arc) => {
                let (sin, cos) = arc.phase_at(longitudinal_m).sin_cos();
                let reach_m = arc.radius_m + lateral_m * arc.turn.sign();
                arc.center_world + reach_m * Vector::new(cos, sin)
            }
        }
    }

    /// Lane coordinates (longitudinal, lateral) of a world point, m; lateral
    /// positive to the right. On an arc the longitudinal coordinate is
    /// measured from the nearer of the two ends, so that it is defined all
    /// around the circle.
    pub fn local_coordinates(&self, point_world: Point) -> (f64, f64) {
        match &self.curve {
            Curve::Straight(line) | Curve::Taper(line) => {
                let from_start = point_world - self.start_world;
                (
                    from_start.dot(&line.forward_world),
                    from_start.dot(&line.right_world()),
                )
            }
            Curve::Arc(arc) => {
                let sign = arc.turn.sign();
                let from_center = point_world - arc.center_world;
                let phase_rad = from_center.y.atan2(from_center.x);
                let past_start_rad = wrap_rad(sign * (phase_rad - arc.start_phase_rad));
                let past_end_rad = wrap_rad(sign * (phase_rad - arc.end_phase_rad()));
                let longitudinal_m = if past_start_rad.abs() > past_end_rad.abs() {
                    past_end_rad * arc.radius_m + self.length_m
                } else {
                    past_start_rad * arc.radius_m
                };
                (longitudinal_m, sign * (from_center.norm() - arc.radius_m))
            }
        }
    }

    /// Heading at a longitudinal coordinate, rad, counter-clockwise; on an
    /// arc it is not wrapped.
    pub fn heading_at(&self, longitudinal_m: f64) -> f64 {
        match &self.curve {
            Curve::Straight(line) | Curve::Taper(line) => line.heading_rad,
            Curve::Arc(arc) => arc.phase_at(longitudinal_m) + FRAC_PI_2 * arc.turn.sign(),
        }
    }

    /// Unit vector along the lane at a longitudinal coordinate.
    pub fn forward_at(&self, longitudinal_m: f64) -> Vector {
        match &self.curve {
            Curve::Straight(line) | Curve::Taper(line) => line.forward_world,
            Curve::Arc(arc) => {
                let (sin, cos) = arc.phase_at(longitudinal_m).sin_cos();
                arc.turn.sign() * Vector::new(-sin, cos)
            }
        }
    }

    /// MetaDrive's distance of a point to a lane, m: lateral offset plus what
    /// lies before the start or beyond the end (`AbstractLane.distance`).
    pub fn distance(&self, point_world: Point) -> f64 {
        let (longitudinal_m, lateral_m) = self.local_coordinates(point_world);
        lateral_m.abs() + (longitudinal_m - self.length_m).max(0.0) + (-longitudinal_m).max(0.0)
    }

    /// Signed curvature radius, m: positive to the left, `None` if straight.
    pub fn bend_radius(&self) -> Option<(f64, Turn)> {
        match &self.curve {
            Curve::Straight(_) | Curve::Taper(_) => None,
            Curve::Arc(arc) => Some((arc.radius_m, arc.turn)),
        }
    }

    /// Whether a point lies on the lane's surface, which in MetaDrive is the
    /// convex hull of the lane grown by `margin_m` (so the inside of a bend
    /// counts, up to the chord).
    pub fn surface_contains(&self, point_world: Point, margin_m: f64) -> bool {
        let half_m = self.width_m / 2.0;
        match &self.curve {
            Curve::Straight(_) | Curve::Taper(_) => {
                let (longitudinal_m, lateral_m) = self.local_coordinates(point_world);
                lateral_m.abs() <= half_m + margin_m
                    && longitudinal_m >= -margin_m
                    && longitudinal_m <= self.surface_length_m() + margin_m
            }
            Curve::Arc(arc) => {
                let from_center = point_world - arc.center_world;
                arc.surface.contains(arc, from_center, half_m, margin_m)
            }
        }
    }

    /// Corners of the lane's surface, a convex polygon, counter-clockwise.
    pub fn surface(&self) -> Vec<Point> {
        let half_m = self.width_m / 2.0;
        match &self.curve {
            Curve::Straight(_) | Curve::Taper(_) => {
                let end_m = self.surface_length_m();
                vec![
                    self.position(0.0, half_m),
                    self.position(end_m, half_m),
                    self.position(end_m, -half_m),
                    self.position(0.0, -half_m),
                ]
            }
            Curve::Arc(arc) => arc.surface.corners(arc, half_m),
        }
    }

    /// The smallest upright box around the lane's surface, for a quick test
    /// before [`Lane::surface_contains`].
    pub fn surface_bounds(&self) -> Bounds {
        match &self.curve {
            Curve::Straight(_) | Curve::Taper(_) => Bounds::around(&self.surface()),
            Curve::Arc(arc) => arc.surface.bounds(arc, self.width_m / 2.0),
        }
    }

    /// MetaDrive samples the surface every metre up to the first sample at or
    /// beyond the end, so it reaches up to a metre past the centre line.
    fn surface_length_m(&self) -> f64 {
        (self.length_m / SURFACE_STEP_M).ceil() * SURFACE_STEP_M
    }
}

/// What makes an arc: an argument of [`Lane::arc`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArcShape {
    /// Centre of the circle.
    pub center_world: Point,
    /// Radius of the centre line, m.
    pub radius_m: f64,
    /// Direction from the centre to the start, rad.
    pub start_phase_rad: f64,
    /// Angle swept, rad.
    pub angle_rad: f64,
    /// Which way it bends.
    pub turn: Turn,
}

/// The length of a vector with MetaDrive's rounding: it squares with the C
/// library's `pow`, which in one case of a thousand differs from a product in
/// the last bit.
pub(crate) fn norm(vector: Vector) -> f64 {
    // The compiler would turn a constant exponent into a product.
    let two = std::hint::black_box(2.0);
    (vector.x.powf(two) + vector.y.powf(two)).sqrt()
}

/// Wraps an angle to (-pi, pi]; pi itself stays pi.
pub fn wrap_rad(angle_rad: f64) -> f64 {
    if angle_rad > -PI && angle_rad <= PI {
        angle_rad
    } else {
        wrap_by_turns_rad(angle_rad)
    }
}

/// Wraps an angle to (-pi, pi] with MetaDrive's rounding: a negative angle
/// goes up a turn and down again, and the bits that it loses there decide
/// further on whether a lane of twenty metres has room for one car or two.
fn wrap_by_turns_rad(angle_rad: f64) -> f64 {
    let rest = rest_of_turns_rad(angle_rad);
    let wrapped = if rest < 0.0 { rest + TAU } else { rest };
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// `angle_rad % TAU`, without its cost where at most one turn comes off: there the
/// difference has no rounding.
fn rest_of_turns_rad(angle_rad: f64) -> f64 {
    let size_rad = angle_rad.abs();
    if size_rad < TAU {
        angle_rad
    } else if size_rad < 2.0 * TAU {
        (size_rad - TAU).copysign(angle_rad)
    } else {
        angle_rad % TAU
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn assert_equal(angle_rad: f64) {
        let (ours, theirs) = (rest_of_turns_rad(angle_rad), angle_rad % TAU);
        assert_eq!(ours.to_bits(), theirs.to_bits(), "{angle_rad}");
    }

    #[test]
    fn the_rest_of_whole_turns_has_the_bits_of_the_remainder() {
        for turns in -4..=4 {
            let angle_rad = f64::from(turns) * TAU;
            assert_equal(angle_rad);
            assert_equal(angle_rad.next_up());
            assert_equal(angle_rad.next_down());
        }
        assert_equal(-0.0);
        assert!(rest_of_turns_rad(f64::NAN).is_nan());
        assert!(rest_of_turns_rad(f64::INFINITY).is_nan());
    }

    proptest! {
        #[test]
        fn the_rest_of_turns_has_the_bits_of_the_remainder(angle_rad in -30.0..30.0_f64) {
            assert_equal(angle_rad);
        }
    }
}
