//! The trait that a robot implements.

use shm_config::message::{Observation, Outcome};
use vehicle::Action;

/// Whether the sensors were read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// They were, for this instant.
    Fresh,
    /// They were not, or their data is older than the robot accepts. The instant counts
    /// as skipped and nothing is published: old data would have a new time. The
    /// controller then brakes (*blind*) after `limits.observation_age_ms`.
    Lost,
}

/// What the robot touches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Contact {
    /// Nothing.
    #[default]
    Free,
    /// A vehicle.
    Vehicle,
    /// Anything else: a wall, a kerb, a box.
    Object,
}

/// Where a robot is in its course.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Status {
    /// How the episode ended; `None` while it is driven. The time limit,
    /// `world.horizon_ticks`, is kept for the robot: at it the robot brakes until the
    /// controller has answered the first observation of the next episode, also a machine
    /// that stays where it is. One that has to drive on sets a larger limit.
    pub ended: Option<Outcome>,
    /// Share of the course driven, [0, 1]; 0 where it is not known.
    pub completion: f64,
    /// Length of the course, m; 0 where it is not known.
    pub course_m: f64,
    /// What it touches now.
    pub contact: Contact,
}

/// A robot, or a simulation of one.
///
/// At each instant of the grid the world process calls [`Robot::obey`] or
/// [`Robot::brake`], then [`Robot::read`], then [`Robot::status`], in a thread with
/// real-time priority: none of them may wait for longer than a part of the period.
/// Which commands are obeyed, their age limit and the brake are decided before the robot
/// is called.
///
/// [`Robot::brake`] is also called, with a step of 0 s, before each [`Robot::begin`] and
/// before the process ends. A process that is killed calls nothing: a machine needs a time
/// limit of its own, after which it brakes when no action arrives.
pub trait Robot {
    /// Begins an episode: a simulation places itself at its start, a machine stays where
    /// it is. It may take as long as it needs; the robot was told to brake before it.
    ///
    /// # Errors
    /// Why it cannot, in words; the world then ends with exit code 2.
    fn begin(&mut self, seed: u64) -> Result<(), String>;

    /// Applies an action, which holds until the next call. Both components are within
    /// [-1, 1]: `steer` is positive to the left, `pedal` drives, or brakes when negative.
    /// `step_s` is the time since the call before, s, at most one tick of the run; a
    /// simulation moves by as much.
    fn obey(&mut self, action: Action, step_s: f64);

    /// Brakes to a stand: no command is there that may be obeyed. Full brake and wheels
    /// straight unless the robot has a better way. With a `step_s` of 0 nothing moves in a
    /// simulation.
    fn brake(&mut self, step_s: f64) {
        self.obey(Action::BRAKE, step_s);
    }

    /// Fills what the sensors see: `ego`, `road`, `checkpoints`, and `ranges_m` with
    /// [`scan`](crate::scan()); their fields give the units and frames. The action last
    /// applied (`ego.steer`, `ego.pedal`) is there already, and so is the scanner of the
    /// run's section `[scanner]`: `lidar_max_m`, and where its beams look (`beam_count`,
    /// `field_of_view_rad`, `scanner_heading_rad`, `scanner_x_body_m`,
    /// `scanner_y_body_m`).
    fn read(&mut self, observation: &mut Observation) -> Reading;

    /// Where it is in its course.
    fn status(&self) -> Status;
}
