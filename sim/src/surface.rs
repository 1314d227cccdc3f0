//! The convex surface of a circular lane, without storing its corners.
//!
//! MetaDrive makes a lane's surface the convex hull of points sampled every
//! metre along the lane, plus one metre of straight road at both ends
//! (`CircularLane.polygon`, `BaseBlock._construct_lane`). A thousand worlds
//! hold some 40 arcs each; testing against the circle instead of a stored
//! polygon keeps a lane within four cache lines.
//!
//! Everything here is in the *arc frame*: origin at the centre of the circle,
//! x through the start of the lane, mirrored if needed so that the lane bends
//! to the left. The lane then starts at angle 0, heading +y.

use vehicle::{Point, Vector};

use crate::lane::{Arc, ArcShape, SURFACE_STEP_M, Turn};

/// An upright box in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lower left corner.
    pub min_world: Point,
    /// Upper right corner.
    pub max_world: Point,
}

impl Bounds {
    /// The box around no point at all: contains nothing.
    pub const EMPTY: Bounds = Bounds {
        min_world: Point::new(f64::INFINITY, f64::INFINITY),
        max_world: Point::new(f64::NEG_INFINITY, f64::NEG_INFINITY),
    };

    /// The box around all points.
    pub(crate) const EVERYWHERE: Bounds = Bounds {
        min_world: Point::new(f64::NEG_INFINITY, f64::NEG_INFINITY),
        max_world: Point::new(f64::INFINITY, f64::INFINITY),
    };

    /// The smallest box around the points.
    pub fn around(points_world: &[Point]) -> Bounds {
        let mut bounds = Bounds::EMPTY;
        for &point_world in points_world {
            bounds.include(point_world);
        }
        bounds
    }

    /// Grows the box until it holds the point.
    pub fn include(&mut self, point_world: Point) {
        self.min_world = self.min_world.inf(&point_world);
        self.max_world = self.max_world.sup(&point_world);
    }

    /// Whether the point is inside, or nearer than `margin_m` along each axis.
    pub fn contains(&self, point_world: Point, margin_m: f64) -> bool {
        point_world.x >= self.min_world.x - margin_m
            && point_world.x <= self.max_world.x + margin_m
            && point_world.y >= self.min_world.y - margin_m
            && point_world.y <= self.max_world.y + margin_m
    }

    /// Whether all of the other box is inside.
    pub fn encloses(&self, other: &Bounds) -> bool {
        self.min_world.x <= other.min_world.x
            && self.min_world.y <= other.min_world.y
            && self.max_world.x >= other.max_world.x
            && self.max_world.y >= other.max_world.y
    }

    /// The corners of the box that [`Bounds::contains`] asks about.
    pub(crate) fn grown(&self, margin_m: f64) -> (Point, Point) {
        let margin = Vector::new(margin_m, margin_m);
        (self.min_world - margin, self.max_world + margin)
    }

    /// The box whose sides are further inside.
    pub(crate) fn shrunk(&self, by_m: f64) -> Bounds {
        let by = Vector::new(by_m, by_m);
        Bounds {
            min_world: self.min_world + by,
            max_world: self.max_world - by,
        }
    }

    /// Cuts off the part that another box reaches, where that keeps `kept`, which must be
    /// inside and must not meet the other. The corners are given as lower left, upper
    /// right. It cuts at the side from which the other is farthest.
    pub(crate) fn keep_off(&mut self, kept: (Point, Point), other: (Point, Point)) {
        let mut widest_m = 0.0;
        let mut cut = None;
        for axis in 0..2 {
            let above_m = other.0[axis] - kept.1[axis];
            if above_m > widest_m {
                (widest_m, cut) = (above_m, Some((axis, true)));
            }
            let below_m = kept.0[axis] - other.1[axis];
            if below_m > widest_m {
                (widest_m, cut) = (below_m, Some((axis, false)));
            }
        }
        match cut {
            Some((axis, true)) => {
                let edge = other.0[axis].next_down();
                self.max_world[axis] = self.max_world[axis].min(edge);
            }
            Some((axis, false)) => {
                let edge = other.1[axis].next_up();
                self.min_world[axis] = self.min_world[axis].max(edge);
            }
            // Not a number: nothing is known of any other place.
            None => *self = Bounds::EMPTY,
        }
    }

    /// The part of both boxes.
    pub(crate) fn within(&self, other: &Bounds) -> Bounds {
        Bounds {
            min_world: self.min_world.sup(&other.min_world),
            max_world: self.max_world.inf(&other.max_world),
        }
    }

    /// Whether the two boxes share a point.
    pub fn overlaps(&self, other: &Bounds) -> bool {
        self.min_world.x <= other.max_world.x
            && other.min_world.x <= self.max_world.x
            && self.min_world.y <= other.max_world.y
            && other.min_world.y <= self.max_world.y
    }
}

/// Directions that the surface of an arc is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub(crate) struct ArcSurface {
    /// From the centre to the start, in the world.
    start: Vector,
    /// From the centre to the last sample, in the arc frame.
    cap: Vector,
    /// Heading at the end of the centre line, in the arc frame.
    exit: Vector,
}

impl ArcSurface {
    pub(crate) fn new(shape: &ArcShape, start_phase_rad: f64) -> ArcSurface {
        let steps = steps(shape.radius_m, shape.angle_rad);
        let (start_sin, start_cos) = start_phase_rad.sin_cos();
        let (cap_sin, cap_cos) = (steps * SURFACE_STEP_M / shape.radius_m).sin_cos();
        let (exit_sin, exit_cos) = shape.angle_rad.sin_cos();
        ArcSurface {
            start: Vector::new(start_cos, start_sin),
            cap: Vector::new(cap_cos, cap_sin),
            exit: Vector::new(-exit_sin, exit_cos),
        }
    }

    /// Whether a point, given from the centre of the circle in world axes,
    /// lies on the surface.
    pub(crate) fn contains(
        &self,
        arc: &Arc,
        from_center: Vector,
        half_m: f64,
        margin_m: f64,
    ) -> bool {
        let (radius_m, turn) = (arc.radius_m, arc.turn);
        let (outer_m, inner_m) = (radius_m + half_m, radius_m - half_m);
        let point = Vector::new(
            from_center.dot(&self.start),
            turn.sign() * (self.start.x * from_center.y - self.start.y * from_center.x),
        );
        if point.norm_squared() > (outer_m + SURFACE_STEP_M + margin_m).powi(2) {
            return false;
        }
        let entry_outer = Vector::new(outer_m, -SURFACE_STEP_M);
        let entry_inner = Vector::new(inner_m, -SURFACE_STEP_M);
        let exit_outer = outer_m * self.cap + SURFACE_STEP_M * self.exit;
        let exit_inner = inner_m * self.cap + SURFACE_STEP_M * self.exit;
        left_of(entry_inner, entry_outer, point, margin_m)
            && point.x <= outer_m + margin_m
            && left_of(exit_outer, exit_inner, point, margin_m)
            && left_of(exit_inner, entry_inner, point, margin_m)
            && self.within_outer_rim(arc, point, (outer_m, exit_outer), margin_m)
    }

    /// The rim is a chain of chords; only the one at the point's angle can
    /// cut it off.
    fn within_outer_rim(
        &self,
        arc: &Arc,
        point: Vector,
        (outer_m, exit_outer): (f64, Vector),
        margin_m: f64,
    ) -> bool {
        let radius_m = arc.radius_m;
        let radii_m = (radius_m, outer_m);
        let rim_end = self.rim_end(arc, outer_m, exit_outer);
        if !left_of(rim_end.0, exit_outer, point, margin_m) {
            return false;
        }
        // Inside every chord: half a step of sagitta, from cos(x) >= 1 - x^2/2.
        let half_step_rad = SURFACE_STEP_M / (2.0 * radius_m);
        let apothem_m = outer_m * (1.0 - half_step_rad * half_step_rad / 2.0) + margin_m;
        if apothem_m > 0.0 && point.norm_squared() <= apothem_m * apothem_m {
            return true;
        }
        let last = (rim_end.1 - 1.0).max(0.0);
        let k = (point.y.atan2(point.x) * radius_m / SURFACE_STEP_M)
            .floor()
            .clamp(0.0, last);
        left_of(rim(k, radii_m), rim(k + 1.0, radii_m), point, margin_m)
    }

    /// The last rim sample that is a corner, and its number: the very last
    /// one falls inside when the exit metre leaves at a smaller angle than
    /// the chord that reaches it.
    fn rim_end(&self, arc: &Arc, outer_m: f64, exit_outer: Vector) -> (Vector, f64) {
        let steps = steps(arc.radius_m, arc.angle_rad);
        let end = outer_m * self.cap;
        let before = rim(steps - 1.0, (arc.radius_m, outer_m));
        if cross(end - before, exit_outer - end) > 0.0 {
            (end, steps)
        } else {
            (before, steps - 1.0)
        }
    }

    /// Corners of the surface in the world, counter-clockwise.
    pub(crate) fn corners(&self, arc: &Arc, half_m: f64) -> Vec<Point> {
        let (outer_m, inner_m) = (arc.radius_m + half_m, arc.radius_m - half_m);
        let exit_outer = outer_m * self.cap + SURFACE_STEP_M * self.exit;
        let rim_steps = self.rim_end(arc, outer_m, exit_outer).1;
        let mut corners = vec![Vector::new(outer_m, -SURFACE_STEP_M)];
        corners.extend((0..=rim_steps as usize).map(|k| rim(k as f64, (arc.radius_m, outer_m))));
        corners.push(exit_outer);
        corners.push(inner_m * self.cap + SURFACE_STEP_M * self.exit);
        corners.push(Vector::new(inner_m, -SURFACE_STEP_M));
        let mut world: Vec<Point> = corners.iter().map(|&c| self.to_world(arc, c)).collect();
        if arc.turn == Turn::Right {
            world.reverse();
        }
        world
    }

    /// A box around the surface: its corners at both ends, and the outermost
    /// points of the circle where the lane passes them.
    pub(crate) fn bounds(&self, arc: &Arc, half_m: f64) -> Bounds {
        let (outer_m, inner_m) = (arc.radius_m + half_m, arc.radius_m - half_m);
        let exit = SURFACE_STEP_M * self.exit;
        let mut bounds = Bounds::EMPTY;
        for corner in [
            Vector::new(outer_m, -SURFACE_STEP_M),
            Vector::new(inner_m, -SURFACE_STEP_M),
            outer_m * self.cap,
            outer_m * self.cap + exit,
            inner_m * self.cap + exit,
        ] {
            bounds.include(self.to_world(arc, corner));
        }
        let swept_rad = steps(arc.radius_m, arc.angle_rad) * SURFACE_STEP_M / arc.radius_m;
        for axis in [Vector::x(), Vector::y(), -Vector::x(), -Vector::y()] {
            let along = axis.dot(&self.start);
            let across = arc.turn.sign() * cross(self.start, axis);
            let phase_rad = across.atan2(along);
            if phase_rad >= 0.0 && phase_rad <= swept_rad {
                bounds.include(arc.center_world + outer_m * axis);
            }
        }
        bounds
    }

    fn to_world(self, arc: &Arc, point: Vector) -> Point {
        let across = arc.turn.sign() * point.y;
        arc.center_world
            + Vector::new(
                self.start.x * point.x - self.start.y * across,
                self.start.y * point.x + self.start.x * across,
            )
    }
}

/// Number of whole steps sampled. It is computed anew because the two cache lines of an
/// arc are full.
fn steps(radius_m: f64, angle_rad: f64) -> f64 {
    (radius_m * angle_rad / SURFACE_STEP_M).ceil()
}

/// The k-th sample on the rim; `radii_m` is (centre line, rim).
fn rim(k: f64, radii_m: (f64, f64)) -> Vector {
    let (sin, cos) = (k * SURFACE_STEP_M / radii_m.0).sin_cos();
    radii_m.1 * Vector::new(cos, sin)
}

fn cross(a: Vector, b: Vector) -> f64 {
    a.x * b.y - a.y * b.x
}

/// Whether a point is left of the line through two others, or within
/// `margin_m` of it.
fn left_of(from: Vector, to: Vector, point: Vector, margin_m: f64) -> bool {
    let along = to - from;
    let area = cross(along, point - from);
    area >= 0.0 || area * area <= margin_m * margin_m * along.norm_squared()
}
