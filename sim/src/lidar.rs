//! The lidar: evenly spaced beams, counter-clockwise; exact distances to boxes and
//! discs. Where they look is `vehicle::Fan`'s.
//!
//! Only the beams that can meet a body are tested against it: those within
//! the angle that the circle around the body fills, rounded up to whole groups of beams
//! that are tested together (`kernel`).

mod kernel;

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};
use std::sync::Arc;

use pulp::{Simd, WithSimd};
use shm_config::draw::Draw;
use vehicle::{BEAMS_MAX, Fan, Point, Scanner, Vector};

use crate::contact::Placed;
use crate::dynamics::Motion;
use crate::simd::Width;
use crate::spawn::ScanNoise;
use kernel::{Beams, CHUNK, Target, shoot};

/// Height of the beams above the ground, m; a body that lies completely above or below
/// is not hit.
pub const BEAM_HEIGHT_M: f64 = 1.2;
/// Most groups of beams.
const CHUNKS: usize = BEAMS_MAX.div_ceil(CHUNK);
/// The same of most scanners: a scan clears that much memory first.
const FEW_CHUNKS: usize = CHUNKS / 8;
/// More than the error of [`bearing_rad`].
const BEARING_ERROR_RAD: f64 = 0.005;

/// The directions and reach of the beams. Copies share the directions.
#[derive(Clone, Debug, PartialEq)]
pub struct Lidar {
    /// In the body frame; the places after the last beam are zero and hit nothing.
    beams_body: Arc<[Beams]>,
    fan: Fan,
    count: usize,
    range_m: f64,
    own: ScanNoise,
    noise: ScanNoise,
    width: Width,
}

/// Where a scan is made from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Origin {
    /// Where all beams begin.
    pub position_world: Point,
    /// Unit vector along the body.
    pub forward_world: Vector,
}

impl Lidar {
    /// The beams of a scanner, at most [`BEAMS_MAX`].
    pub fn new(scanner: &Scanner) -> Lidar {
        let fan = scanner.fan();
        let count = fan.beams.min(BEAMS_MAX);
        let mut beams_body = vec![Beams::default(); count.div_ceil(CHUNK)];
        for k in 0..count {
            let (sin, cos) = fan.angle_rad(k).sin_cos();
            let beams = &mut beams_body[k / CHUNK];
            (beams.x[k % CHUNK], beams.y[k % CHUNK]) = (cos, sin);
        }
        let own = ScanNoise {
            drop_probability: scanner.drop_probability,
            range_m: 0.0,
        };
        Lidar {
            beams_body: beams_body.into(),
            fan,
            count,
            range_m: scanner.range_m,
            own,
            noise: own,
            width: Width::default(),
        }
    }

    /// Where its beams look.
    pub fn fan(&self) -> &Fan {
        &self.fan
    }

    /// Where the scan of a car begins.
    pub fn origin(&self, motion: &Motion) -> Origin {
        let forward_world = motion.seen_forward();
        let left_world = Vector::new(-forward_world.y, forward_world.x);
        let mount_body = self.fan.mount_body;
        Origin {
            position_world: motion.seen_position()
                + (forward_world * mount_body.x + left_world * mount_body.y),
            forward_world,
        }
    }

    /// An episode begins, with what is wrong with its scans beside what the scanner has.
    pub fn begin(&mut self, noise: ScanNoise) {
        self.noise = ScanNoise {
            drop_probability: self.own.drop_probability.max(noise.drop_probability),
            range_m: noise.range_m,
        };
    }

    /// Disturbs ranges, and takes some returns away: such a beam shows its full range. `of`
    /// are two numbers that decide which and how.
    pub fn disturb(&self, of: (u64, u64), ranges_m: &mut [f32]) {
        let ScanNoise {
            drop_probability,
            range_m: deviation_m,
        } = self.noise;
        let seed = Draw::new(of.0).bits() ^ of.1;
        let (mut draw, max_m) = (Draw::new(seed), self.range_m as f32);
        if drop_probability > 0.0 {
            for range_m in ranges_m.iter_mut().take(self.count) {
                if draw.within(0.0, 1.0) < drop_probability {
                    *range_m = max_m;
                }
            }
        }
        if deviation_m > 0.0 {
            let hits = ranges_m.iter_mut().take(self.count);
            for range_m in hits.filter(|range_m| **range_m < max_m) {
                // Irwin and Hall: the sum of 12 even draws is nearly normal.
                let sum: f64 = (0..12).map(|_| draw.within(-0.5, 0.5)).sum();
                // A return beyond the reach is none.
                *range_m = ((f64::from(*range_m) + deviation_m * sum) as f32).clamp(0.0, max_m);
            }
        }
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
        self.width.widest.dispatch(Scan {
            lidar: self,
            origin,
            bodies,
            ranges_m,
        });
    }

    /// What the beams are tested against; `None` if it is out of their reach.
    fn target(&self, origin: &Origin, body: &Placed) -> Option<(Target, [Span; 2])> {
        let to_body = body.center_world - origin.position_world;
        let radius_m = body.shape.radius_m();
        let square = to_body.norm_squared();
        if square > (self.range_m + radius_m).powi(2) {
            return None;
        }
        let target = Target {
            shape: body.shape,
            from: body.to_body(-to_body),
            turn: body.to_body(origin.forward_world),
        };
        if square <= radius_m * radius_m {
            return Some((target, self.all()));
        }
        let ahead = origin.forward_world;
        let bearing_rad = bearing_rad(ahead.dot(&to_body), ahead.perp(&to_body));
        // At least the arc sine: equal at both ends of [0, 1], above it between them.
        let sine = radius_m / square.sqrt();
        let span_rad = sine * (1.0 + (FRAC_PI_2 - 1.0) * sine * sine) + BEARING_ERROR_RAD;
        Some((
            target,
            self.between(bearing_rad - span_rad, bearing_rad + span_rad),
        ))
    }

    fn all(&self) -> [Span; 2] {
        [(0, self.beams_body.len()), (0, 0)]
    }

    /// The groups that hold all beams between two angles, rad, each in (-TAU, TAU).
    fn between(&self, begin_rad: f64, end_rad: f64) -> [Span; 2] {
        match self.fan.is_circle() && self.fan.heading_rad == 0.0 {
            true => self.between_on_circle(begin_rad, end_rad),
            false => self.between_in_fan(begin_rad, end_rad),
        }
    }

    /// The same of any fan: it meets the angles on this turn, on the one before, or both.
    fn between_in_fan(&self, begin_rad: f64, end_rad: f64) -> [Span; 2] {
        let per_rad = 1.0 / self.fan.spacing_rad();
        // The angles counted from the first beam on, the first of them on its turn.
        let from_first_rad = begin_rad - self.fan.angle_rad(0);
        let begin_turn = from_first_rad - (from_first_rad / TAU).floor() * TAU;
        let length_rad = end_rad - begin_rad;
        [begin_turn, begin_turn - TAU].map(|begin_rad| {
            // Rounded away from the middle.
            let first = (begin_rad * per_rad).floor().max(0.0);
            let last = ((begin_rad + length_rad) * per_rad).ceil();
            let last = last.min(self.count as f64 - 1.0);
            match first <= last {
                true => (first as usize / CHUNK, last as usize / CHUNK + 1),
                false => (0, 0),
            }
        })
    }

    fn between_on_circle(&self, begin_rad: f64, end_rad: f64) -> [Span; 2] {
        let count = self.count as i64;
        let beams_per_rad = self.count as f64 / TAU;
        // Rounded away from the middle; the offset makes the numbers positive, which
        // makes the conversion round down.
        let first = ((begin_rad + TAU) * beams_per_rad) as i64 - count;
        let last = ((end_rad + TAU) * beams_per_rad) as i64 + 1 - count;
        if last - first + 1 >= count {
            return self.all();
        }
        let around = |beam: i64| match beam {
            beam if beam < 0 => beam + count,
            beam if beam >= count => beam - count,
            beam => beam,
        };
        let (begin, end) = (around(first) as usize, around(last) as usize);
        match begin <= end {
            true => [(begin / CHUNK, end / CHUNK + 1), (0, 0)],
            false => [(begin / CHUNK, self.beams_body.len()), (0, end / CHUNK + 1)],
        }
    }
}

/// The first group of beams, and the one after the last.
type Span = (usize, usize);

/// The angle of a vector, rad, in [-PI, PI], to within 0.004.
fn bearing_rad(x: f64, y: f64) -> f64 {
    let (across, along) = (y.abs(), x.abs());
    // A body around the origin itself never comes here, so the quotient is a number.
    let slope = across.min(along) / across.max(along);
    let first_octant_rad = slope * (FRAC_PI_4 + 0.273 * (1.0 - slope));
    let first_quarter_rad = match across > along {
        true => FRAC_PI_2 - first_octant_rad,
        false => first_octant_rad,
    };
    let upper_rad = match x < 0.0 {
        true => PI - first_quarter_rad,
        false => first_quarter_rad,
    };
    upper_rad.copysign(y)
}

/// One scan, compiled for each width of vectors.
struct Scan<'a, I> {
    lidar: &'a Lidar,
    origin: &'a Origin,
    bodies: I,
    ranges_m: &'a mut [f32],
}

impl<I: Iterator<Item = Placed>> WithSimd for Scan<'_, I> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.lidar.beams_body.len() <= FEW_CHUNKS {
            true => self.find::<S, FEW_CHUNKS>(simd),
            false => self.find::<S, CHUNKS>(simd),
        }
    }
}

impl<I: Iterator<Item = Placed>> Scan<'_, I> {
    /// With room for this many groups of beams.
    #[inline(always)]
    fn find<S: Simd, const GROUPS: usize>(self, simd: S) {
        let Scan { lidar, origin, .. } = self;
        // The nearest distance is rounded at the end: that equals the least of the
        // rounded ones.
        let mut nearest_m = [[lidar.range_m; CHUNK]; GROUPS];
        for body in self.bodies {
            let Some((target, spans)) = lidar.target(origin, &body) else {
                continue;
            };
            for (begin, end) in spans {
                let beams = &lidar.beams_body[begin..end];
                shoot(simd, &target, beams, &mut nearest_m[begin..end]);
            }
        }
        let nearest_m = &nearest_m.as_flattened()[..lidar.count];
        for (range_m, &nearest_m) in self.ranges_m.iter_mut().zip(nearest_m) {
            *range_m = nearest_m as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bearings_are_within_their_error() {
        for k in -40_000..=40_000 {
            let angle_rad = f64::from(k) * PI / 40_000.0;
            let (sin, cos) = angle_rad.sin_cos();
            let error_rad = bearing_rad(7.0 * cos, 7.0 * sin) - angle_rad;
            let error_rad = error_rad - (error_rad / TAU).round() * TAU;
            assert!(
                error_rad.abs() < 0.8 * BEARING_ERROR_RAD,
                "{angle_rad}: {error_rad}"
            );
        }
    }

    #[test]
    fn the_bound_of_the_span_is_above_the_arc_sine() {
        for k in 0..=10_000 {
            let sine = f64::from(k) / 10_000.0;
            let bound_rad = sine * (1.0 + (FRAC_PI_2 - 1.0) * sine * sine);
            assert!(bound_rad >= sine.asin() - 1e-15, "{sine}");
        }
    }
}
