use core::f64::consts::{FRAC_PI_2, PI};

#[cfg(not(feature = "std"))]
use crate::Float as _;
use crate::{Fan, Point, Vector, rem_euclid, wrap_rad};

/// What the beams of a fan see, with the limits of the field of view worked out: a plan
/// asks for thousands of places, and an angle for each would cost more than the plan.
///
/// A place is seen when it is inside the field of view and no beam that passes it leaves
/// room for a whole car between: at most a given distance, the car's width, beside a beam.
/// So a few wide gaps are not taken for sight. How far away the place is does not matter
/// otherwise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    fan: Fan,
    /// Unit vectors along the right and the left limit of the field of view.
    limits_body: [Vector; 2],
    extent: Extent,
    /// Sine of the largest angle between a direction in the field of view and the beam
    /// nearest to it.
    gap_sin: f64,
}

/// How much of the circle a field of view has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// Nothing: a scanner without beams is dead.
    Nothing,
    /// At most half of the circle: what is inside of both limits.
    Narrow,
    /// More than half of it: what is inside of one limit at least.
    Wide,
    /// The full circle.
    All,
}

impl Fan {
    /// What it sees.
    pub fn sight(&self) -> Sight {
        let half_rad = self.seen_half_rad();
        let along = |angle_rad: f64| {
            let (sin, cos) = (self.heading_rad + angle_rad).sin_cos();
            Vector::new(cos, sin)
        };
        let extent = match half_rad {
            _ if self.beams == 0 => Extent::Nothing,
            half_rad if self.is_circle() || half_rad >= PI => Extent::All,
            half_rad if half_rad > FRAC_PI_2 => Extent::Wide,
            _ => Extent::Narrow,
        };
        let gap_rad = match self.beams {
            1 => half_rad,
            _ => self.spacing_rad() / 2.0,
        };
        Sight {
            fan: *self,
            limits_body: [along(-half_rad), along(half_rad)],
            extent,
            gap_sin: gap_rad.min(FRAC_PI_2).sin(),
        }
    }
}

impl Sight {
    /// The beams.
    pub fn fan(&self) -> &Fan {
        &self.fan
    }

    /// How much of the circle it has.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// Unit vectors along the right and the left limit of the field of view.
    pub fn limits_body(&self) -> [Vector; 2] {
        self.limits_body
    }

    /// Whether all places of the field of view up to this distance from the scanner are
    /// at most `beside_m` beside a beam.
    pub fn has_no_gap(&self, distance_m: f64, beside_m: f64) -> bool {
        distance_m * self.gap_sin <= beside_m
    }

    /// Whether all places up to this distance from the scanner are seen.
    pub fn covers_all(&self, distance_m: f64, beside_m: f64) -> bool {
        self.extent == Extent::All && self.has_no_gap(distance_m, beside_m)
    }

    /// Whether a place of the body frame is seen: in the field of view, or as little beside
    /// it as [`Fan::seen_half_rad`] says, and at most `beside_m` beside a beam.
    pub fn covers(&self, place_body: Point, beside_m: f64) -> bool {
        let from_mount = place_body - self.fan.mount_body;
        let [right, left] = self.limits_body;
        let (inside_right, inside_left) = (
            right.perp(&from_mount) >= 0.0,
            from_mount.perp(&left) >= 0.0,
        );
        let is_within = match self.extent {
            Extent::Nothing => false,
            Extent::Narrow => inside_right && inside_left,
            Extent::Wide => inside_right || inside_left,
            Extent::All => true,
        };
        is_within
            && (self.has_no_gap(from_mount.norm(), beside_m)
                || self.beside_beam_m(from_mount) <= beside_m)
    }

    /// Distance from the beam nearest in direction, m; infinite behind it.
    fn beside_beam_m(&self, from_mount: Vector) -> f64 {
        let angle_rad = from_mount.y.atan2(from_mount.x);
        let beam = self.fan.beam_at(angle_rad);
        let beams = self.fan.beams as f64;
        let nearest = match self.fan.is_circle() {
            true => rem_euclid(beam, beams).round(),
            false => beam.round().min(beams - 1.0),
        };
        // The conversion of what is below 0 saturates.
        let off_rad = wrap_rad(angle_rad - self.fan.angle_rad(nearest as usize)).abs();
        match off_rad < FRAC_PI_2 {
            true => from_mount.norm() * off_rad.sin(),
            false => f64::INFINITY,
        }
    }
}
