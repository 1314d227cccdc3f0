//! The car: its truth moves, its sensors measure, its observation is what they tell.

use robot::estimate::Mean;
use robot::{Action, Bicycle, Config, Observation, Reading, Robot, Status, scan, wrap_rad};
use shm_config::Instant;
use vehicle::{Fan, Pose};

use crate::course::Course;
use crate::dice::Dice;
use crate::estimator::{Estimator, seen_m};
use crate::options::{Options, Source};
use crate::sensors::{Motion, Sensors};
use crate::walls::range_m;

/// Wheels and IMU measure so often in each call of `obey`: at 50 Hz in ticks of 10 Hz.
const SAMPLES: u64 = 5;
/// Distance between the checkpoints along the route, m.
const SPACING_M: f64 = 15.0;
/// Deviation of the true start from the start that the filter is given: that of
/// `Start::default`, m and rad.
const START_STD: [f64; 2] = [0.1, 0.02];

pub struct Car {
    options: Options,
    course: Course,
    bicycle: Bicycle,
    fan: Fan,
    max_m: f64,
    now: Instant,
    sensors: Sensors,
    estimator: Option<Estimator>,
    /// How far the car has driven along the route, in truth, m.
    driven_m: f64,
    /// Where on the route it believes to be, m.
    along_m: Option<f64>,
    seed: u64,
    errors: Errors,
}

/// Errors of the estimate in an episode.
#[derive(Default)]
struct Errors {
    ticks: u64,
    place_m2: f64,
    place_max_m: f64,
    heading_rad2: f64,
    speed_m2ps2: f64,
    nees: f64,
}

impl Car {
    /// # Errors
    /// None with the course of `course.rs`.
    pub fn new(config: &Config, options: Options) -> Result<Self, String> {
        Ok(Self {
            options,
            course: Course::new()?,
            bicycle: Bicycle::new(config.vehicle),
            fan: config.scanner.fan(),
            max_m: config.scanner.range_m,
            now: Instant(0),
            sensors: Sensors::new(0, options),
            estimator: None,
            driven_m: 0.0,
            along_m: None,
            seed: 0,
            errors: Errors::default(),
        })
    }

    fn along_m(&self) -> f64 {
        let place = self.bicycle.state.position;
        self.course.route.locate(place, None).along_m
    }

    fn look(&mut self) {
        let (place, heading_rad) = (
            self.bicycle.state.pose() * self.fan.mount_body,
            self.bicycle.state.heading_rad,
        );
        let (fan, walls) = (self.fan, &self.course.walls);
        let seen =
            (0..fan.beams).map(|beam| range_m(walls, place, heading_rad + fan.angle_rad(beam)));
        self.sensors.look(self.now, seen);
    }

    /// Fills road and checkpoints for a pose on the map.
    fn fill_course(&mut self, observation: &mut Observation, world_from_body: &Pose) {
        let route = &self.course.route;
        let located = route.fill(observation, world_from_body, SPACING_M, self.along_m);
        self.along_m = Some(located.along_m);
    }

    fn read_truth(&mut self, observation: &mut Observation) -> Reading {
        let pose = self.bicycle.state.pose();
        self.bicycle.fill(&mut observation.ego);
        self.fill_course(observation, &pose);
        let (mount, walls) = (pose * self.fan.mount_body, &self.course.walls);
        let heading_rad = self.bicycle.state.heading_rad;
        scan(observation, |rad| range_m(walls, mount, heading_rad + rad));
        Reading::Fresh
    }

    fn read_estimate(&mut self, observation: &mut Observation) -> Reading {
        self.look();
        let Some(estimator) = &mut self.estimator else {
            return Reading::Lost;
        };
        for (taken, message) in self.sensors.arrived(self.now) {
            estimator.take(self.now, taken, message, &self.course);
        }
        let Some(estimate) = estimator.estimate(self.now) else {
            return Reading::Lost;
        };
        let (state, yaw_rate_radps) = (&self.bicycle.state, self.bicycle.yaw_rate_radps);
        let error = estimate.error(&Mean::from([
            state.position.x,
            state.position.y,
            state.heading_rad,
            state.speed_mps,
            yaw_rate_radps,
            0.0,
            0.0,
            0.0,
        ]));
        let spread = estimate.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let pose_error = error.fixed_rows::<3>(0).into_owned();
        let nees = spread
            .cholesky()
            .map(|it| pose_error.dot(&it.solve(&pose_error)));
        self.errors.add(&error, nees.unwrap_or(f64::NAN));
        let Some(seen) = estimator.seen(&estimate) else {
            return Reading::Lost;
        };
        estimate.fill(&mut observation.ego);
        let mount = self.fan.mount_body;
        scan(observation, |rad| seen_m(&seen, mount, rad));
        self.fill_course(observation, &estimate.world_from_body());
        Reading::Fresh
    }

    /// Writes the errors of the episode to the log.
    fn report(&self) {
        let Some(estimator) = self.estimator.as_ref().filter(|_| self.errors.ticks > 0) else {
            return;
        };
        let (errors, counts) = (&self.errors, estimator.counts());
        let ticks = errors.ticks as f64;
        // The last report comes after the log is closed; what is written here is in it still.
        eprintln!(
            "estimate: seed={} place_rms_m={:.4} place_max_m={:.4} heading_rms_rad={:.5} \
             speed_rms_mps={:.4} pose_nees={:.3} applied={} rejected={} late={} refused={} \
             unaligned={}",
            self.seed,
            (errors.place_m2 / ticks).sqrt(),
            errors.place_max_m,
            (errors.heading_rad2 / ticks).sqrt(),
            (errors.speed_m2ps2 / ticks).sqrt(),
            errors.nees / ticks,
            counts.applied,
            counts.rejected,
            counts.late,
            counts.refused,
            estimator.unaligned,
        );
    }
}

impl Errors {
    fn add(&mut self, error: &Mean, nees: f64) {
        let place_m = error[0].hypot(error[1]);
        self.ticks += 1;
        self.place_m2 += place_m * place_m;
        self.place_max_m = self.place_max_m.max(place_m);
        self.heading_rad2 += error[2] * error[2];
        self.speed_m2ps2 += error[3] * error[3];
        self.nees += nees;
    }
}

impl Robot for Car {
    fn begin(&mut self, seed: u64) -> Result<(), String> {
        self.report();
        let mut dice = Dice::new(seed ^ 0x5eed);
        // Anywhere on the loop, up to a metre from its middle.
        let begin_m = dice.unit() * self.course.route.length_m();
        let (middle, ..) = self.course.route.at(begin_m);
        let start = middle * vehicle::pose(0.0, 2.0 * dice.unit() - 1.0, 0.0);
        let [place_m, turn_rad] = START_STD;
        let off = vehicle::pose(
            place_m * dice.normal(),
            place_m * dice.normal(),
            turn_rad * dice.normal(),
        );
        let truth = start * off;
        let place = truth.translation.vector.into();
        self.bicycle.place(place, wrap_rad(truth.rotation.angle()));
        self.sensors = Sensors::new(seed, self.options);
        let estimator = Estimator::new(
            (self.options.source, &self.sensors),
            (self.fan, self.max_m),
            self.bicycle.vehicle.wheelbase_m,
            Estimator::start(self.now, &start, self.options.noise),
        );
        self.estimator = match self.options.source {
            Source::Truth => None,
            Source::Map | Source::Scans | Source::Wheels => {
                Some(estimator.map_err(|error| error.to_string())?)
            }
        };
        self.driven_m = 0.0;
        self.along_m = None;
        self.seed = seed;
        self.errors = Errors::default();
        Ok(())
    }

    fn obey(&mut self, action: Action, step_s: f64) {
        if step_s <= 0.0 {
            return;
        }
        let before_m = self.along_m();
        let sample_s = step_s / SAMPLES as f64;
        for _ in 0..SAMPLES {
            let speed_mps = self.bicycle.state.speed_mps;
            self.bicycle.advance(action, sample_s);
            self.now = self.now.after_ns((sample_s * 1e9).round() as u64);
            let motion = Motion {
                speed_mps: self.bicycle.state.speed_mps,
                yaw_rate_radps: self.bicycle.yaw_rate_radps,
                accel_mps2: (self.bicycle.state.speed_mps - speed_mps) / sample_s,
                steer_rad: action.control(&self.bicycle.vehicle).steer_rad,
            };
            if self.estimator.is_some() {
                self.sensors.feel(self.now, motion);
            }
        }
        let length_m = self.course.route.length_m();
        let moved_m = self.along_m() - before_m;
        // Over the end of the loop the distance begins again.
        self.driven_m += moved_m - length_m * (moved_m / length_m).round();
    }

    fn read(&mut self, observation: &mut Observation) -> Reading {
        match self.options.source {
            Source::Truth => self.read_truth(observation),
            Source::Map | Source::Scans | Source::Wheels => self.read_estimate(observation),
        }
    }

    fn status(&self) -> Status {
        let pose = self.bicycle.state.pose();
        self.course
            .status(&pose, &self.bicycle.vehicle, self.driven_m)
    }
}

impl Drop for Car {
    fn drop(&mut self) {
        self.report();
    }
}
