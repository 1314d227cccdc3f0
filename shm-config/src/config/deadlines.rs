use serde::{Deserialize, Serialize};

use super::{Config, OutOfRange, in_range};
use crate::message::{PARTS, Part};
use crate::services::Process;

/// What follows when a tick is done after its deadline, one period after it was
/// due.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Late {
    /// It is counted; its answer goes out all the same.
    Count,
    /// Its answer is held back: those who wait go on with the one before, up to
    /// its age limit.
    Skip,
    /// The car brakes.
    Brake,
}

/// Deadlines and budgets: what is slow is counted by name, and what is late does
/// not have to be obeyed. None in lockstep.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Deadlines {
    /// An instant of the world that begins when the next one is due: count; skip,
    /// nothing is published; brake, nothing is obeyed.
    pub world: Late,
    /// A plan that is done a period after its observation was due: count; skip, it
    /// is not published; brake, it says that the way is blocked.
    pub planner: Late,
    /// A command that is decided a period after its tick was due: count; skip, it
    /// is not sent; brake, it brakes.
    pub controller: Late,
    /// Budget of the world for obeying and moving, as a share of its period.
    pub world_move: f64,
    /// Budget of the world for sensing, likewise.
    pub world_observe: f64,
    /// Budget of the world for publishing, likewise.
    pub world_send: f64,
    /// Budget of the planner for admission, as a share of its period.
    pub planner_admit: f64,
    /// Budget of the planner for its grid, likewise.
    pub planner_grid: f64,
    /// Budget of the planner for its search, likewise.
    pub planner_search: f64,
    /// Budget of the planner for publishing, likewise.
    pub planner_send: f64,
    /// Budget of the controller for waiting for its plan, as a share of its period.
    pub controller_wait: f64,
    /// Budget of the controller for its decision, likewise.
    pub controller_decide: f64,
    /// Budget of the controller for publishing, likewise.
    pub controller_send: f64,
}

impl Default for Deadlines {
    fn default() -> Self {
        Self {
            world: Late::Count,
            planner: Late::Count,
            controller: Late::Count,
            world_move: 0.2,
            world_observe: 0.2,
            world_send: 0.1,
            planner_admit: 0.05,
            planner_grid: 0.2,
            // A plan that takes longer comes after `limits.plan_wait`: its tick
            // follows the one before.
            planner_search: 0.4,
            planner_send: 0.1,
            controller_wait: 0.5,
            controller_decide: 0.2,
            controller_send: 0.1,
        }
    }
}

impl Deadlines {
    fn shares(&self) -> [(&'static str, Process, Part, f64); 10] {
        use Process::{Controller, Planner, World};
        [
            ("world_move", World, Part::Move, self.world_move),
            ("world_observe", World, Part::Observe, self.world_observe),
            ("world_send", World, Part::Send, self.world_send),
            ("planner_admit", Planner, Part::Admit, self.planner_admit),
            ("planner_grid", Planner, Part::Grid, self.planner_grid),
            ("planner_search", Planner, Part::Search, self.planner_search),
            ("planner_send", Planner, Part::Send, self.planner_send),
            (
                "controller_wait",
                Controller,
                Part::Wait,
                self.controller_wait,
            ),
            (
                "controller_decide",
                Controller,
                Part::Decide,
                self.controller_decide,
            ),
            (
                "controller_send",
                Controller,
                Part::Send,
                self.controller_send,
            ),
        ]
    }

    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        for (key, _, _, share) in self.shares() {
            in_range(&format!("deadlines.{key}"), share, 1e-6..=1.0)?;
        }
        Ok(())
    }
}

impl Config {
    /// The budgets of a process's parts, ns, by [`Part`]; no end for parts that it
    /// does not have, and in lockstep.
    pub fn budgets_ns(&self, process: Process) -> [u64; PARTS] {
        let mut budgets = [u64::MAX; PARTS];
        let Some(rate_hz) = self.rate_hz(process).filter(|_| !self.run.is_lockstep()) else {
            return budgets;
        };
        for (_, whose, part, share) in self.deadlines.shares() {
            if whose == process {
                budgets[part.code() as usize] = (share * 1e9 / rate_hz) as u64;
            }
        }
        budgets
    }
}
