use serde::{Deserialize, Serialize};

use super::{Config, Late, OutOfRange, in_range};
use crate::message::{PARTS, Part};
use crate::services::Process;

/// Deadlines and budgets: slow parts of a tick are counted by name, and late answers
/// may be withheld. None apply in lockstep.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Deadlines {
    /// For an instant of the world that begins when the next one is due: count; skip,
    /// nothing is published; brake, the car is braked.
    pub world: Late,
    /// For a plan that is done a period after its observation was due: count; skip, it
    /// is not published; brake, it is published as blocked.
    pub planner: Late,
    /// For a command that is decided a period after its tick was due: count; skip, it
    /// is not sent; brake, it brakes.
    pub controller: Late,
    /// The budgets of the parts of a tick, as a multiple of the built-in ones (the
    /// planner's search has 0.4 of its period). A part that takes longer is counted as
    /// an overrun.
    pub budget_scale: f64,
}

impl Default for Deadlines {
    fn default() -> Self {
        Self {
            world: Late::Count,
            planner: Late::Count,
            controller: Late::Count,
            budget_scale: 1.0,
        }
    }
}

/// Built-in budgets of the parts of a tick, as shares of the process's period.
const BUDGETS: [(Process, Part, f64); 10] = {
    use Process::{Controller, Planner, World};
    [
        (World, Part::Move, 0.2),
        (World, Part::Observe, 0.2),
        (World, Part::Send, 0.1),
        (Planner, Part::Admit, 0.05),
        (Planner, Part::Grid, 0.2),
        // A plan that takes longer arrives after `limits.plan_wait`: its tick uses the
        // previous plan.
        (Planner, Part::Search, 0.4),
        (Planner, Part::Send, 0.1),
        (Controller, Part::Wait, 0.5),
        (Controller, Part::Decide, 0.2),
        (Controller, Part::Send, 0.1),
    ]
};

impl Deadlines {
    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        in_range("deadlines.budget_scale", self.budget_scale, 1e-6..=10.0)
    }
}

impl Config {
    /// The budgets of a process's parts, ns, by [`Part`]; unlimited for parts that it
    /// does not have, and in lockstep.
    pub fn budgets_ns(&self, process: Process) -> [u64; PARTS] {
        let mut budgets = [u64::MAX; PARTS];
        let Some(rate_hz) = self.rate_hz(process).filter(|_| !self.run.is_lockstep()) else {
            return budgets;
        };
        for (_, part, share) in BUDGETS.iter().filter(|(of, ..)| *of == process) {
            let share = share * self.deadlines.budget_scale;
            budgets[part.code() as usize] = (share * 1e9 / rate_hz) as u64;
        }
        budgets
    }
}
