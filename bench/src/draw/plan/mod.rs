//! One plan, as in the paper's Figure 3: grid, tree, path, goal.

mod axes;
mod branches;
mod cells;
mod figure;
mod source;
mod view;

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

#[cfg(test)]
mod tests {
    use shm_config::config::planner::Method;
    use shm_config::message::{PlanOutcome, Waypoint};

    use super::*;
    use crate::scene;

    /// A plan as model-predictive control makes it: one waypoint and one action
    /// each 0.1 s, on a gentle bend.
    fn predicted() -> Planned {
        let scene = scene::checked_in().expect("the scenes").swap_remove(174);
        let config = Config::default();
        let mut planner = Planner::new(&config).expect("the default planner");
        let mut plan = Box::<Plan>::default();
        planner.plan(&scene.observation, &mut plan);
        plan.outcome = PlanOutcome::Reached.code();
        plan.action_step_s = 0.1;
        plan.action_count = 25;
        plan.waypoint_count = 26;
        for (k, waypoint) in plan.waypoints[..26].iter_mut().enumerate() {
            let x_m = 0.5 * k as f64;
            *waypoint = Waypoint {
                x_body_m: x_m,
                y_body_m: 0.9 * (0.25 * x_m).sin(),
                speed_mps: 5.0,
            };
        }
        Planned {
            title: "A prediction".into(),
            name: "prediction".into(),
            config,
            planner,
            observation: scene.observation,
            plan,
        }
    }

    #[test]
    fn a_tree_over_poses_is_drawn_with_its_curves() {
        let scene = scene::checked_in().expect("the scenes").swap_remove(174);
        let mut config = Config::default();
        config.planner.method = Method::Kinodynamic;
        let mut planner = Planner::new(&config).expect("the planner");
        let mut plan = Box::<Plan>::default();
        planner.plan(&scene.observation, &mut plan);
        assert!(plan.nodes > 1, "a tree");
        let branches = branches::of(&planner).expect("a tree");
        assert_eq!(branches.len(), plan.nodes as usize);
        let text = figure::svg(&Planned {
            title: "A tree".into(),
            name: "tree".into(),
            config,
            planner,
            observation: scene.observation,
            plan,
        });
        assert!(text.contains("cost-to-come"), "the scale of its costs");
    }

    #[test]
    fn a_plan_with_actions_is_a_trajectory_and_no_tree() {
        let text = figure::svg(&predicted());
        for word in ["predicted trajectory", "2.5 s ahead in 25 actions"] {
            assert!(text.contains(word), "{word}");
        }
        assert!(
            !text.contains("cost-to-come"),
            "no tree, no scale of its costs"
        );
    }
}
