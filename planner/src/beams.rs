use shm_config::message::{BEAMS_MAX, Observation};
#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Point, Vector};

/// The directions of the lidar's beams in the body frame, kept between plans
/// because the sine and cosine of 240 beams cost more than the grid.
#[derive(Debug, Default)]
pub(crate) struct Beams {
    directions_body: heapless::Vec<Vector, BEAMS_MAX>,
}

impl Beams {
    /// Directions for this many evenly spaced beams, at most the capacity.
    pub(crate) fn prepare(&mut self, count: usize) {
        let count = count.min(BEAMS_MAX);
        if self.directions_body.len() == count {
            return;
        }
        self.directions_body.clear();
        self.directions_body
            .extend((0..count).map(|beam| direction_body(beam, count)));
    }

    /// The points that were hit; a beam at its full range hit nothing.
    pub(crate) fn returns<'a>(
        &'a self,
        observation: &'a Observation,
    ) -> impl Iterator<Item = Point> + 'a {
        observation
            .ranges()
            .iter()
            .zip(&self.directions_body)
            .filter(|&(&range_m, _)| range_m < observation.lidar_max_m)
            .map(|(&range_m, direction)| Point::from(direction * f64::from(range_m)))
    }
}

/// Beam k at `k * 360 deg / count`, counter-clockwise from x.
///
/// The right half is the left half mirrored, to the last bit: left and right
/// are then treated alike.
fn direction_body(beam: usize, count: usize) -> Vector {
    let angle_rad = |beam: usize| core::f64::consts::TAU * beam as f64 / count as f64;
    if 2 * beam == count {
        return Vector::new(-1.0, 0.0);
    }
    if 2 * beam > count {
        let (sin, cos) = angle_rad(count - beam).sin_cos();
        return Vector::new(cos, -sin);
    }
    let (sin, cos) = angle_rad(beam).sin_cos();
    Vector::new(cos, sin)
}
