//! Recorded scenes: observations of real episodes that a planner answered, in a file
//! that other programs can write, too. `stack/scenes/README.md` describes the format.

mod file;
mod line;
mod record;

pub use file::{CHECKED_IN_NAME, checked_in, read, write};
pub use record::{Recording, record};

use planner::Planner;
use shm_config::message::{Observation, Plan, PlanOutcome};

/// What the car saw at one tick, and at the tick before it.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Its source, for readers of the file.
    pub origin: Origin,
    /// What is to be planned for.
    pub observation: Box<Observation>,
    /// What was seen a tick earlier: planners that go on from their last plan
    /// get it first. None at the beginning of an episode.
    pub before: Option<Box<Observation>>,
}

/// Where a scene is from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Origin {
    /// The episode's seed.
    pub seed: u64,
    /// What the driver's planner found there.
    pub outcome: PlanOutcome,
}

impl Scene {
    /// Prepares a planner for the scene: it forgets other scenes and plans the tick
    /// before this one.
    pub fn prepare(&self, planner: &mut Planner, plan: &mut Plan) {
        planner.forget();
        if let Some(before) = &self.before {
            planner.plan(before, plan);
        }
    }
}
