use shm_config::message::{BEAMS_MAX, Observation};
use vehicle::{Fan, Point, Vector};

/// The directions of the lidar's beams in the body frame, kept between plans
/// because the sine and cosine of 240 beams cost more than the grid.
#[derive(Debug, Default)]
pub(crate) struct Beams {
    fan: Option<Fan>,
    directions_body: heapless::Vec<Vector, BEAMS_MAX>,
}

impl Beams {
    /// Directions for the beams of this fan, at most the capacity.
    pub(crate) fn prepare(&mut self, fan: Fan) {
        if self.fan == Some(fan) {
            return;
        }
        self.fan = Some(fan);
        self.directions_body.clear();
        let count = fan.beams.min(BEAMS_MAX);
        self.directions_body
            .extend((0..count).map(|beam| fan.direction_body(beam)));
    }

    /// The points that were hit; a beam at its full range hit nothing.
    pub(crate) fn returns<'a>(
        &'a self,
        observation: &'a Observation,
    ) -> impl Iterator<Item = Point> + 'a {
        let mount_body = observation.fan().mount_body;
        observation
            .ranges()
            .iter()
            .zip(&self.directions_body)
            .filter(|&(&range_m, _)| range_m < observation.lidar_max_m)
            .map(move |(&range_m, direction)| mount_body + direction * f64::from(range_m))
    }
}
