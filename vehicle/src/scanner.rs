use core::f64::consts::{PI, TAU};

use serde::{Deserialize, Serialize};

#[cfg(not(feature = "std"))]
use crate::Float as _;
use crate::parameters::in_ranges;
use crate::{InvalidVehicle, Point, Vector, wrap_rad};

/// Most beams of a scanner: two for each tenth of a degree and more than any 2D scanner
/// of today has over 270 degrees at 0.15 degrees.
pub const BEAMS_MAX: usize = 2048;

/// See [`Fan::seen_half_rad`].
const BESIDE_MAX_RAD: f64 = 5.0 / 180.0 * PI;

/// The car's laser scanner. The defaults are the paper's experiment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scanner {
    /// Beams of a scan. Over the full circle, the first looks along the scanner's
    /// heading; over less, the first looks along the right limit of the field of view,
    /// the last along the left one. Counter-clockwise.
    pub beams: u32,
    /// Field of view, degrees, centred on the scanner's heading; 360 is the full circle.
    pub field_of_view_deg: f64,
    /// Range, m.
    pub range_m: f64,
    /// Mounting position, m forward of the body's centre.
    pub x_m: f64,
    /// Mounting position, m left of the body's centre.
    pub y_m: f64,
    /// Heading of the scanner in the body frame, degrees, counter-clockwise.
    pub heading_deg: f64,
    /// Probability that a beam that hits something gives no return. It then shows its
    /// full range, as a beam that hits nothing: a scanner cannot tell the two apart.
    pub drop_probability: f64,
}

impl Default for Scanner {
    fn default() -> Self {
        Self {
            beams: 240,
            field_of_view_deg: 360.0,
            range_m: 50.0,
            x_m: 0.0,
            y_m: 0.0,
            heading_deg: 0.0,
            drop_probability: 0.0,
        }
    }
}

impl Scanner {
    /// Where its beams look.
    pub fn fan(&self) -> Fan {
        Fan {
            beams: self.beams as usize,
            // 360 degrees in rad are one bit off the full circle on some machines.
            field_of_view_rad: match self.field_of_view_deg >= 360.0 {
                true => TAU,
                false => self.field_of_view_deg.to_radians(),
            },
            heading_rad: self.heading_deg.to_radians(),
            mount_body: Point::new(self.x_m, self.y_m),
        }
    }

    /// Checks every number; the count of beams is one of them.
    ///
    /// # Errors
    /// The first that is not finite or outside its range.
    pub fn validated(self) -> Result<Self, InvalidVehicle> {
        in_ranges(&[
            ("beams", f64::from(self.beams), [1.0, BEAMS_MAX as f64]),
            ("field_of_view_deg", self.field_of_view_deg, [1.0, 360.0]),
            ("range_m", self.range_m, [0.5, 500.0]),
            ("x_m", self.x_m, [-30.0, 30.0]),
            ("y_m", self.y_m, [-10.0, 10.0]),
            ("heading_deg", self.heading_deg, [-180.0, 180.0]),
            // At 1 the scanner would be blind.
            ("drop_probability", self.drop_probability, [0.0, 0.9]),
        ])?;
        Ok(self)
    }
}

/// Where the beams of a scan look: the one place that knows the angle of a beam.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fan {
    /// Number of beams.
    pub beams: usize,
    /// Angle between the first beam and the last, rad; a full circle from 2π on, and
    /// then the last beam is one gap before the first.
    pub field_of_view_rad: f64,
    /// Heading of the fan's middle in the body frame, rad, counter-clockwise.
    pub heading_rad: f64,
    /// Where all beams begin.
    pub mount_body: Point,
}

impl Fan {
    /// Whether the beams cover the full circle.
    pub fn is_circle(&self) -> bool {
        self.field_of_view_rad >= TAU
    }

    /// Angle between two neighbouring beams, rad; of a single beam the field of view.
    pub fn spacing_rad(&self) -> f64 {
        self.field_of_view_rad / self.gaps()
    }

    fn gaps(&self) -> f64 {
        match self.is_circle() {
            true => self.beams.max(1) as f64,
            false => self.beams.saturating_sub(1).max(1) as f64,
        }
    }

    /// Angle of beam k in the body frame, rad, counter-clockwise from x; not wrapped.
    pub fn angle_rad(&self, beam: usize) -> f64 {
        self.heading_rad + self.angle_in_fan_rad(beam)
    }

    fn angle_in_fan_rad(&self, beam: usize) -> f64 {
        if self.is_circle() {
            return TAU * beam as f64 / self.gaps();
        }
        if self.beams < 2 {
            return 0.0;
        }
        // From the middle: beams at the same distance from it have the same angle with
        // opposite signs, to the last bit.
        let from_middle = 2.0 * beam as f64 - self.gaps();
        self.field_of_view_rad * from_middle / (2.0 * self.gaps())
    }

    /// Unit vector along beam k in the body frame.
    ///
    /// Of a fan that looks along x, the right half is the left half mirrored, to the last
    /// bit: left and right are then treated alike.
    pub fn direction_body(&self, beam: usize) -> Vector {
        if !self.is_circle() || self.heading_rad != 0.0 {
            let (sin, cos) = self.angle_rad(beam).sin_cos();
            return Vector::new(cos, sin);
        }
        if 2 * beam == self.beams {
            return Vector::new(-1.0, 0.0);
        }
        if 2 * beam > self.beams {
            let (sin, cos) = self.angle_rad(self.beams - beam.min(self.beams)).sin_cos();
            return Vector::new(cos, -sin);
        }
        let (sin, cos) = self.angle_rad(beam).sin_cos();
        Vector::new(cos, sin)
    }

    /// The point at a distance along beam k, m, in the body frame.
    pub fn point_body(&self, beam: usize, range_m: f64) -> Point {
        self.mount_body + self.direction_body(beam) * range_m
    }

    /// Which beam looks in a direction from the mount, rad in the body frame, as a
    /// number with a fraction: 1.5 is the middle between the beams 1 and 2. On a full
    /// circle the turn is the caller's; below 0 or above the last beam nothing looks.
    pub fn beam_at(&self, angle_rad: f64) -> f64 {
        let in_fan_rad = angle_rad - self.heading_rad;
        match self.is_circle() {
            true => in_fan_rad / self.spacing_rad(),
            false => (wrap_rad(in_fan_rad) + self.field_of_view_rad / 2.0) / self.spacing_rad(),
        }
    }

    /// Half of the angle that counts as seen, rad: half a gap beyond the outermost beams,
    /// at most 5 degrees, so that a few wide gaps are not taken for sight.
    pub fn seen_half_rad(&self) -> f64 {
        self.field_of_view_rad / 2.0 + (self.spacing_rad() / 2.0).min(BESIDE_MAX_RAD)
    }
}
