//! From messages of the sensors to what an observation says.

use robot::Point;
use robot::estimate::{Counts, align};
use robot::estimate::{Estimate, EstimateError, Filter, Measurement, Outline, Settings, Start};
use shm_config::Instant;
use vehicle::{Fan, Pose};

use crate::course::Course;
use crate::options::Source;
use crate::sensors::{ACCEL_BIAS_STD, GYRO_BIAS_STD, Message, Sensors, points};
use crate::walls::{Wall, along, range_m};

/// Oldest scan that an observation may show, ns: at 8 m/s the car has moved by 4 m since.
const SCAN_AGE_MAX_NS: u64 = 500_000_000;
/// Errors of an alignment that its points have in common, m. With the map: in a bend the
/// scan shows no turn about the bend's centre, and at 0.02 m the guess confirms itself until
/// the car is 0.3 m along from where the filter believes to be; at 0.1 m it does not.
const MAP_STD_M: f64 = 0.1;
/// With the scan before: what two scans show differently because walls end.
const SCANS_STD_M: f64 = 0.01;

pub struct Estimator {
    source: Source,
    filter: Filter,
    fan: Fan,
    max_m: f64,
    range_std_m: f64,
    current: Outline,
    reference: Outline,
    /// The newest scan: when it was taken, and its points as walls in its body frame.
    newest: Option<(Instant, Vec<Wall>)>,
    /// Scans that could not be aligned.
    pub unaligned: u64,
}

impl Estimator {
    /// # Errors
    /// Settings that the filter refuses.
    pub fn new(
        (source, sensors): (Source, &Sensors),
        (fan, max_m): (Fan, f64),
        wheelbase_m: f64,
        start: Start,
    ) -> Result<Self, EstimateError> {
        let settings = Settings {
            wheelbase_m,
            ..Settings::default()
        };
        Ok(Self {
            source,
            filter: Filter::new(&settings, &sensors.noise(), &start)?,
            fan,
            max_m,
            range_std_m: sensors.range_std_m(),
            current: Outline::new(),
            reference: Outline::new(),
            newest: None,
            unaligned: 0,
        })
    }

    /// A start at a pose that is known but for 0.1 m and 0.02 rad.
    pub fn start(at: Instant, world_from_body: &Pose, noise: f64) -> Start {
        let mut start = Start {
            at,
            ..Start::default()
        };
        let place = world_from_body.translation.vector;
        start.mean[..3].copy_from_slice(&[place.x, place.y, world_from_body.rotation.angle()]);
        start.std[6] = (GYRO_BIAS_STD * noise).max(1e-3);
        start.std[7] = (ACCEL_BIAS_STD * noise).max(1e-2);
        start
    }

    pub fn take(&mut self, now: Instant, taken: Instant, message: Message, course: &Course) {
        match message {
            // What the filter refuses it counts.
            Message::Motion(measurement) => {
                let _ = self.filter.add(now, taken, measurement);
            }
            Message::Scan(ranges_m) => self.take_scan(now, taken, &ranges_m, course),
        }
    }

    fn take_scan(&mut self, now: Instant, taken: Instant, ranges_m: &[f64], course: &Course) {
        if self
            .newest
            .as_ref()
            .is_some_and(|(newest, _)| *newest >= taken)
        {
            return;
        }
        self.newest = Some((taken, along(&points(&self.fan, ranges_m))));
        let Ok(estimate) = self.filter.estimate(taken) else {
            return;
        };
        let ranges_m = ranges_m.iter().copied();
        self.current
            .fill(&self.fan, ranges_m, self.max_m, self.range_std_m);
        match self.source {
            Source::Map => self.align_with_map(now, &estimate, course),
            Source::Scans => self.align_with_scan(now, &estimate),
            Source::Truth | Source::Wheels => {}
        }
    }

    /// The place on the map: the scan is aligned with what the map shows from where the
    /// filter believes to be.
    fn align_with_map(&mut self, now: Instant, estimate: &Estimate, course: &Course) {
        let world_from_guess = estimate.world_from_body();
        let (mount, heading_rad) = (
            world_from_guess * self.fan.mount_body,
            world_from_guess.rotation.angle(),
        );
        let seen = (0..self.fan.beams)
            .map(|beam| range_m(&course.walls, mount, heading_rad + self.fan.angle_rad(beam)));
        self.reference.fill(&self.fan, seen, self.max_m, 0.0);
        match align(&self.reference, &self.current, &Pose::identity()) {
            Ok(aligned) if aligned.observed > 0 => {
                let (world_from_body, information) =
                    aligned.blurred(MAP_STD_M).seen_from(&world_from_guess);
                let place = Measurement::Place {
                    world_from_body,
                    information,
                };
                let _ = self.filter.add(now, estimate.at, place);
            }
            _ => self.unaligned += 1,
        }
    }

    /// The motion since the scan before.
    fn align_with_scan(&mut self, now: Instant, estimate: &Estimate) {
        if let Some((since, guess)) = estimate.keyframe {
            match align(&self.reference, &self.current, &guess) {
                Ok(aligned) if aligned.observed > 0 => {
                    let aligned = aligned.blurred(SCANS_STD_M);
                    let motion = Measurement::Motion {
                        since,
                        keyframe_from_body: aligned.reference_from_body,
                        information: aligned.information,
                    };
                    let _ = self.filter.add(now, estimate.at, motion);
                }
                _ => self.unaligned += 1,
            }
        }
        // The reference is always the scan of the keyframe.
        if self
            .filter
            .add(now, estimate.at, Measurement::Keyframe)
            .is_ok()
        {
            std::mem::swap(&mut self.reference, &mut self.current);
        }
    }

    /// What the filter believes of now.
    pub fn estimate(&self, now: Instant) -> Option<Estimate> {
        self.filter.estimate(now).ok()
    }

    /// What the newest scan shows, as walls in its body frame, and the body of now in this
    /// frame; `None` without a scan that is young enough.
    pub fn seen(&self, now: &Estimate) -> Option<(&[Wall], Pose)> {
        let (taken, walls) = self.newest.as_ref()?;
        if now.at.since_ns(*taken) > SCAN_AGE_MAX_NS {
            return None;
        }
        let then = self.filter.estimate(*taken).ok()?;
        let then_from_now = then.world_from_body().inverse() * now.world_from_body();
        Some((walls, then_from_now))
    }

    pub fn counts(&self) -> Counts {
        self.filter.counts()
    }
}

/// The range that walls show from a pose in their frame, m.
pub fn seen_m((walls, frame_from_body): &(&[Wall], Pose), mount: Point, direction_rad: f64) -> f64 {
    let turned_rad = frame_from_body.rotation.angle();
    range_m(walls, frame_from_body * mount, turned_rad + direction_rad)
}
