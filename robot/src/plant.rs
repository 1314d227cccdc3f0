//! What the world process moves and observes.

use shm_config::Instant;
use shm_config::message::{Command, Episode, Observation, Outcome, Progress};

use crate::robot::Reading;

/// An instant of the world's grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moment {
    /// Its number, counted from the world's first instant.
    pub index: u64,
    /// The tick of the run in which it lies.
    pub tick: u64,
    /// When the process woke up for it, on the run's clock.
    pub now: Instant,
    /// Instants that passed without a tick just before it.
    pub missed: u64,
}

/// What the world process moves and observes: the built-in world, or a robot.
///
/// The process decides when and by which command it moves. At each instant it calls
/// [`Plant::advance`], then [`Plant::observe`]. At the world's first instant nothing has
/// moved, so it only observes; with `deadlines.world = "skip"` a late instant only moves.
pub trait Plant {
    /// Begins an episode.
    ///
    /// # Errors
    /// Why it cannot, in words; the process then ends.
    fn begin(&mut self, episode: u32, seed: u64) -> Result<(), String>;

    /// Moves from the instant before to this one. Without a command it brakes: there is
    /// none, or none that may be obeyed. Returns how the episode ended, if it did.
    fn advance(&mut self, moment: Moment, command: Option<&Command>) -> Option<Outcome>;

    /// Fills an observation, except its header and the three instants after it.
    fn observe(&mut self, moment: Moment, observation: &mut Observation) -> Reading;

    /// The progress of the episode, without its header.
    fn progress(&self, outcome: Outcome) -> Progress;

    /// The finished episode, without its header.
    fn episode(&self, outcome: Outcome) -> Episode;
}
