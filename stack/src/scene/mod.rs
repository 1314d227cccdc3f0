//! Recorded scenes: what a planner was asked in real episodes, in a file that
//! others can write, too. `stack/scenes/README.md` describes the format.

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
    /// Where it is from; for people.
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
    /// Brings a planner to where the scene begins: nothing of other scenes, and
    /// the plan of the tick before.
    pub fn prepare(&self, planner: &mut Planner, plan: &mut Plan) {
        planner.forget();
        if let Some(before) = &self.before {
            planner.plan(before, plan);
        }
    }
}
