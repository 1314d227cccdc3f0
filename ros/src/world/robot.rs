//! The robot as the crate `robot` drives it.

use robot::route::corridor::Search;
use robot::route::{Located, Route};
use robot::{Action, Observation, Outcome, Reading, Robot, Status};
use shm_config::Instant;
use shm_config::config::Config;
use triple_buffer::{Input, Output, triple_buffer};
use vehicle::{BEAMS_MAX, Pose};

use super::voice::{Voice, VoiceThread};
use crate::setpoint::Setpoint;
use crate::settings::Settings;
use crate::wall::Moment;

/// Checkpoints are so many seconds at the present speed ahead, and at least so many lengths of
/// the car.
const AHEAD_S: f64 = 2.0;
const AHEAD_LENGTHS: f64 = 8.0;
/// The end of the path is reached within this share of the car's length.
const ARRIVED_LENGTHS: f64 = 0.5;
/// A corridor is looked for over so many lengths of the car.
const CORRIDOR_LENGTHS: f64 = 30.0;
/// The directions that a corridor needs, to each side, degrees.
const CORRIDOR_DEG: i32 = 80;
/// Most returns that a corridor is looked for among.
const RETURNS_MAX: usize = BEAMS_MAX + 2 * CORRIDOR_DEG as usize + 1;

/// The newest scan on the run's beams.
#[derive(Debug, Clone)]
pub struct Seen {
    /// When it was taken; `None` before the first.
    pub taken: Option<Instant>,
    /// The ranges of the beams, m.
    pub ranges_m: Vec<f32>,
}

impl Default for Seen {
    fn default() -> Self {
        Self {
            taken: None,
            ranges_m: vec![0.0; BEAMS_MAX],
        }
    }
}

/// The newest odometry.
#[derive(Debug, Clone, Copy)]
pub struct Moved {
    /// When it was taken; `None` before the first.
    pub taken: Option<Instant>,
    /// The number of times that its frame has changed.
    pub frame: u64,
    /// The car's centre.
    pub pose: Pose,
    /// Forward, m/s.
    pub speed_mps: f64,
    /// Counter-clockwise, rad/s.
    pub yaw_rate_radps: f64,
}

impl Default for Moved {
    fn default() -> Self {
        Self {
            taken: None,
            frame: 0,
            pose: Pose::identity(),
            speed_mps: 0.0,
            yaw_rate_radps: 0.0,
        }
    }
}

/// The newest path.
#[derive(Debug, Clone, Default)]
pub struct Course {
    /// Counts the different paths that came; 0 before the first.
    pub number: u64,
    /// That of the odometry whose frame it is in: see [`Moved::frame`].
    pub frame: u64,
    /// In the frame of the odometry; `None` for a path that cannot be followed.
    pub route: Option<Route>,
}

/// What the tick reads.
pub struct Heard {
    /// The scan.
    pub seen: Output<Seen>,
    /// The odometry.
    pub moved: Output<Moved>,
    /// The path.
    pub course: Output<Course>,
}

/// Where others put it.
pub struct Slots {
    /// The scan.
    pub seen: Input<Seen>,
    /// The odometry.
    pub moved: Input<Moved>,
    /// The path.
    pub course: Input<Course>,
}

/// Both ends.
pub fn slots() -> (Slots, Heard) {
    let (seen_in, seen) = triple_buffer(&Seen::default());
    let (moved_in, moved) = triple_buffer(&Moved::default());
    let (course_in, course) = triple_buffer(&Course::default());
    let slots = Slots {
        seen: seen_in,
        moved: moved_in,
        course: course_in,
    };
    (
        slots,
        Heard {
            seen,
            moved,
            course,
        },
    )
}

/// A ROS robot.
pub struct RosRobot {
    heard: Heard,
    voice: Voice,
    setpoint: Setpoint,
    age_ns: u64,
    follows_path: bool,
    ahead_min_m: f64,
    arrived_m: f64,
    width_m: f64,
    search: Search,
    /// Direction, rad from the heading, and range, m, of each return, and of each direction
    /// in which no beam looks.
    returns: Vec<(f64, f64)>,
    /// Where on the path it is, and the path's number.
    located: Option<(u64, Located)>,
    /// The number of the path that was driven to its end.
    done: u64,
    /// Joined when the robot is dropped, after the last brake.
    _thread: VoiceThread,
}

impl RosRobot {
    /// Starts the connection to the router in a thread of its own; returns at once.
    ///
    /// # Errors
    /// One line: a run in lockstep, or a thread that cannot be started.
    pub fn open(config: &Config, settings: &Settings) -> Result<Self, String> {
        if config.run.is_lockstep() {
            return Err("a ROS robot drives in real time: start it without --lockstep".into());
        }
        let (slots, heard) = slots();
        let (voice, thread) = VoiceThread::start(config, settings, slots)?;
        let vehicle = config.vehicle;
        let half_width_m = settings.robot.half_width_m(&vehicle);
        Ok(Self {
            heard,
            voice,
            setpoint: Setpoint::new(vehicle),
            age_ns: (settings.robot.age_ms * 1e6) as u64,
            follows_path: !settings.robot.path.is_empty(),
            ahead_min_m: AHEAD_LENGTHS * vehicle.length_m,
            arrived_m: ARRIVED_LENGTHS * vehicle.length_m,
            width_m: vehicle.width_m,
            returns: Vec::with_capacity(RETURNS_MAX),
            search: Search {
                half_width_m,
                ahead_m: CORRIDOR_LENGTHS * vehicle.length_m,
                side_max_m: 4.0 * half_width_m,
            },
            located: None,
            done: 0,
            _thread: thread,
        })
    }

    /// Road and checkpoints by the path; `None` without one to follow.
    fn follow(&mut self, observation: &mut Observation) -> Option<Located> {
        let course = self.heard.course.peek_output_buffer();
        let route = course.route.as_ref()?;
        if course.number == self.done {
            return None;
        }
        let moved = self.heard.moved.peek_output_buffer();
        // The path is laid into another frame within a tenth of a second.
        if course.frame != moved.frame {
            return None;
        }
        let last = self.located.filter(|(number, _)| *number == course.number);
        let ahead_m = (moved.speed_mps * AHEAD_S).max(self.ahead_min_m);
        let last_m = last.map(|(_, located)| located.along_m);
        Some(route.fill(observation, &moved.pose, ahead_m, last_m))
    }

    /// Road and checkpoints by the scan.
    fn search(&mut self, observation: &mut Observation) {
        let (fan, max_m) = (observation.fan(), observation.lidar_max_m);
        let ranges = observation.ranges().iter().enumerate();
        let met = ranges.filter(|(_, range_m)| **range_m < max_m);
        let met = met.map(|(beam, range_m)| fan.point_body(beam, f64::from(*range_m)));
        let met = met.map(|place| (place.y.atan2(place.x), place.coords.norm()));
        // Where no beam looks there is no way.
        let near_m = 1.9 * self.search.half_width_m;
        let (sight, width_m) = (fan.sight(), self.width_m);
        let unseen = (-CORRIDOR_DEG..=CORRIDOR_DEG).filter_map(|degree| {
            let angle_rad = f64::from(degree).to_radians();
            let place = robot::Point::new(near_m * angle_rad.cos(), near_m * angle_rad.sin());
            (!sight.covers(place, width_m)).then_some((angle_rad, near_m))
        });
        self.returns.clear();
        // They fit: nothing is allocated.
        self.returns.extend(met.chain(unseen));
        self.search.fill(observation, self.returns.iter().copied());
    }

    fn is_young(&self, taken: Option<Instant>, now: Instant) -> bool {
        taken.is_some_and(|taken| now.since_ns(taken) <= self.age_ns)
    }

    /// Reads at this instant.
    fn read_at(&mut self, now: Instant, observation: &mut Observation) -> Reading {
        self.heard.seen.update();
        self.heard.moved.update();
        self.heard.course.update();
        let (seen, moved) = (
            self.heard.seen.peek_output_buffer(),
            *self.heard.moved.peek_output_buffer(),
        );
        if !self.is_young(seen.taken, now) || !self.is_young(moved.taken, now) {
            return Reading::Lost;
        }
        let ego = &mut observation.ego;
        (ego.x_world_m, ego.y_world_m) = (moved.pose.translation.x, moved.pose.translation.y);
        ego.heading_world_rad = moved.pose.rotation.angle();
        ego.speed_mps = moved.speed_mps;
        ego.yaw_rate_radps = moved.yaw_rate_radps;
        let beams = observation.ranges().len();
        observation.ranges_m[..beams].copy_from_slice(&seen.ranges_m[..beams]);
        if !self.follows_path {
            self.search(observation);
            return Reading::Fresh;
        }
        match self.follow(observation) {
            Some(located) => {
                let number = self.heard.course.peek_output_buffer().number;
                self.located = Some((number, located));
                Reading::Fresh
            }
            // A robot without a path stands. Where it is on one that returns stays known.
            None => Reading::Lost,
        }
    }
}

impl Robot for RosRobot {
    /// The robot stays where it is; the path that has ended is not driven again.
    fn begin(&mut self, _seed: u64) -> Result<(), String> {
        if self.status().ended.is_some() {
            self.done = self.heard.course.peek_output_buffer().number;
        }
        self.located = None;
        Ok(())
    }

    fn obey(&mut self, action: Action, step_s: f64) {
        let measured_mps = self.heard.moved.peek_output_buffer().speed_mps;
        let drive = self.setpoint.drive(action, measured_mps, step_s);
        self.voice.say(drive);
    }

    fn brake(&mut self, _step_s: f64) {
        let drive = self.setpoint.brake();
        self.voice.say(drive);
    }

    fn read(&mut self, observation: &mut Observation) -> Reading {
        self.read_at(Moment::now().now, observation)
    }

    fn status(&self) -> Status {
        let course = self.heard.course.peek_output_buffer();
        let (Some(route), Some((number, located))) = (&course.route, self.located) else {
            return Status::default();
        };
        if number != course.number {
            return Status::default();
        }
        let length_m = route.length_m();
        let has_arrived = !route.is_closed() && located.along_m >= length_m - self.arrived_m;
        Status {
            ended: has_arrived.then_some(Outcome::Arrived),
            completion: (located.along_m / length_m).clamp(0.0, 1.0),
            course_m: length_m,
            ..Status::default()
        }
    }
}
