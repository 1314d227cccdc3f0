use shm_config::message::{BEAMS_MAX, Observation};
use vehicle::{Fan, Point, Sight, Vector};

/// The directions of the lidar's beams in the body frame, and what they see, kept between
/// plans because the sine and cosine of 240 beams cost more than the grid.
#[derive(Debug, Default)]
pub struct Beams {
    sight: Option<Sight>,
    directions_body: heapless::Vec<Vector, BEAMS_MAX>,
}

impl Beams {
    /// Directions for the beams of this fan, at most the capacity.
    pub fn prepare(&mut self, fan: Fan) {
        if self.sight.is_some_and(|sight| *sight.fan() == fan) {
            return;
        }
        self.sight = Some(fan.sight());
        self.directions_body.clear();
        let count = fan.beams.min(BEAMS_MAX);
        self.directions_body
            .extend((0..count).map(|beam| fan.direction_body(beam)));
    }

    /// What the fan prepared last sees.
    pub fn sight(&self) -> Option<Sight> {
        self.sight
    }

    /// The directions of the fan prepared last.
    pub fn directions_body(&self) -> &[Vector] {
        &self.directions_body
    }

    /// The beams that hit something, and where; a beam at its full range hit nothing.
    #[cfg(feature = "std")]
    pub fn returns<'a>(
        &'a self,
        observation: &'a Observation,
    ) -> impl Iterator<Item = (usize, Point)> + 'a {
        let mount_body = observation.fan().mount_body;
        let beams = 0..observation.ranges().len();
        beams.filter_map(move |beam| Some((beam, self.hit(observation, mount_body, beam)?)))
    }

    /// The point that a beam hit, from a scanner that is mounted there; `None` when it hit
    /// nothing.
    pub fn hit(&self, observation: &Observation, mount_body: Point, beam: usize) -> Option<Point> {
        let range_m = *observation.ranges().get(beam)?;
        let direction = self.directions_body.get(beam)?;
        let is_hit = range_m < observation.lidar_max_m;
        is_hit.then(|| mount_body + direction * f64::from(range_m))
    }
}
