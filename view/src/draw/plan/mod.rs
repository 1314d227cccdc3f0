//! Draws one plan, as in the paper's Figure 3: grid, tree, path and goal.

mod axes;
pub(crate) mod branches;
mod cells;
mod figure;
mod source;
mod view;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{ArgGroup, Args};
use planner::Planner;
use shm_config::config::Config;
use shm_config::message::{Observation, Plan};
use shm_config::run::RunName;
use stack::driver::DriverKind;
use supervisor::cli::parsers::whole;
use supervisor::subcommand::{Configuration, Output, Subcommand};

use super::{ending_in, write};
use stack::Clock;

/// A plan: the grid, the search tree, the path, the goal.
#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("source").required(true).args(["seed", "scene", "run"]),
    after_help = "Draws a plan of an episode that is driven up to a tick, of a recorded scene, or of a \
        running run. For a run, the newest observation is planned for again with the run's \
        configuration.\n\n\
        Examples:\n  \
        ./vlaps draw plan --seed 1000 --tick 120\n  \
        ./vlaps draw plan --scene stack/scenes/built_in.jsonl.gz --index 17 --driver mpc\n  \
        ./vlaps draw plan --run default"
)]
pub struct DrawPlan {
    /// Seed of the episode to drive.
    #[arg(long, value_name = "N", requires = "tick", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: Option<u64>,
    /// Tick of the episode, from 0; requires --seed.
    #[arg(long, value_name = "T", requires = "seed", conflicts_with_all = ["scene", "run"],
          allow_negative_numbers = true, value_parser = whole::<u64>(0..=u64::MAX))]
    pub tick: Option<u64>,
    /// File of recorded scenes; stack/scenes/README.md describes it.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Index of the scene in the file, from 0.
    #[arg(long, value_name = "I", default_value_t = 0, requires = "scene",
          conflicts_with_all = ["seed", "run"], allow_negative_numbers = true,
          value_parser = whole::<usize>(0..=u64::MAX))]
    pub index: usize,
    /// Name of a running run, whose configuration is used.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["driver", "config", "overrides"])]
    pub run: Option<RunName>,
    /// Driver whose planner is drawn.
    #[arg(long, value_name = "DRIVER", default_value = "expert")]
    pub driver: DriverKind,
    /// Output file; default: plan-SOURCE.svg.
    #[arg(long, value_name = "FILE.svg", value_parser = ending_in(".svg"))]
    pub out: Option<PathBuf>,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
}

impl Subcommand for DrawPlan {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::File("--out", self.out.clone())]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let planned = source::planned(self, clock)?;
        let file = format!("plan-{}.svg", planned.name);
        write(self.out.clone(), &file, &figure::svg(&planned))?;
        Ok(ExitCode::SUCCESS)
    }
}

/// A plan with everything that was used to make it.
pub struct Planned {
    /// Source of the plan, as the title.
    title: String,
    /// Source of the plan, as part of a file name.
    name: String,
    /// The configuration of the planner.
    config: Config,
    /// The planner, which still holds its grid and tree.
    planner: Planner,
    observation: Box<Observation>,
    plan: Box<Plan>,
}

#[cfg(test)]
mod tests {
    use shm_config::config::planner::Method;
    use shm_config::message::{PlanOutcome, Waypoint};

    use super::*;
    use stack::scene;

    /// A plan as made by model-predictive control: one waypoint and one action per 0.1 s, on a
    /// gentle curve.
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
        let branches = recorder::standard::branches(&planner).expect("a tree");
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
