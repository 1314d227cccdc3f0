//! One plan, as in the paper's Figure 3: grid, tree, path, goal.

mod cells;
mod figure;
mod source;

use planner::Planner;
use shm_config::config::Config;
use shm_config::message::{Observation, Plan};

use super::write;
use crate::Clock;
use crate::arguments::DrawPlan;

/// A plan with everything that it was made from.
pub struct Planned {
    /// Where the scene is from, as a title.
    title: String,
    /// The same, for a file's name.
    name: String,
    /// The configuration that it was planned with.
    config: Config,
    /// The planner, which still holds its grid and tree.
    planner: Planner,
    observation: Box<Observation>,
    plan: Box<Plan>,
}

/// Draws a plan.
///
/// # Errors
/// When the configuration is wrong, the seed has no map or its episode ends
/// before the tick, the scene is not there, the run is not alive, or the file
/// cannot be written.
pub fn plan(arguments: &DrawPlan, clock: Clock) -> anyhow::Result<()> {
    let planned = source::planned(arguments, clock)?;
    let file = format!("plan-{}.svg", planned.name);
    write(arguments.out.clone(), &file, &figure::svg(&planned))
}
