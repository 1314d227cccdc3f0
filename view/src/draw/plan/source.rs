//! The source of the plan to draw: an episode, a recorded scene, or a run.

use std::time::Duration;

use anyhow::{anyhow, bail};
use planner::Planner;
use shm_config::config::{self, Config};
use shm_config::message::{Message, Observation, Plan, Step};
use shm_config::run::{RunName, RunPaths};
use shm_config::services::{Process, STEP};
use shm_config::wire::Wire;
use sim::{World, WorldConfig};
use supervisor::cli::failure::Failure;
use supervisor::machine::signals::pause;
use supervisor::run::leftovers::clean_run;

use super::{DrawPlan, Planned};
use stack::Clock;
use stack::driver::EpisodeDriver;
use stack::episode::drive;
use stack::scene;

/// Time limit for a run's next step, ns; ten periods and more.
const LISTEN_NS: u64 = 2_000_000_000;
/// Polling interval.
const LOOK: Duration = Duration::from_millis(20);

/// The plan that the command line requests.
pub(super) fn planned(arguments: &DrawPlan, clock: Clock) -> anyhow::Result<Planned> {
    if let Some(name) = &arguments.run {
        return of_run(name, clock);
    }
    let config = arguments.configuration.resolve()?;
    let config = arguments.driver.configure(&config);
    if let Some(path) = &arguments.scene {
        let mut scenes = scene::read(path)?;
        let count = scenes.len();
        if arguments.index >= count {
            let last = count - 1;
            let path = path.display();
            bail!(
                "--index {}: {path} has the scenes 0 to {last}",
                arguments.index
            );
        }
        let scene = scenes.swap_remove(arguments.index);
        let mut source = SourcePlanner::new(config)?;
        scene.prepare(&mut source.planner, &mut source.plan);
        let (seed, tick) = (scene.origin.seed, scene.observation.header.tick);
        let title = format!("Scene {}: seed {seed}, tick {tick}", arguments.index);
        let name = format!("scene-{}", arguments.index);
        return Ok(source.finish(scene.observation, title, name));
    }
    of_episode(arguments, config, clock)
}

/// A planner with its configuration, before the plan.
struct SourcePlanner {
    config: Config,
    planner: Planner,
    plan: Box<Plan>,
}

impl SourcePlanner {
    fn new(config: Config) -> anyhow::Result<SourcePlanner> {
        Ok(SourcePlanner {
            planner: Planner::new(&config)?,
            plan: Box::default(),
            config,
        })
    }

    fn finish(mut self, observation: Box<Observation>, title: String, name: String) -> Planned {
        self.planner.plan(&observation, &mut self.plan);
        Planned {
            title,
            name,
            config: self.config,
            planner: self.planner,
            observation,
            plan: self.plan,
        }
    }
}

/// Drives an episode up to a tick. A second planner plans at each tick, so that a planner
/// with memory has the same memory as the driver's.
fn of_episode(arguments: &DrawPlan, config: Config, clock: Clock) -> anyhow::Result<Planned> {
    let (Some(seed), Some(wanted)) = (arguments.seed, arguments.tick) else {
        bail!("--seed needs a --tick");
    };
    let mut world = World::new(WorldConfig::from(&config))?;
    let mut driver = EpisodeDriver::new(arguments.driver, &config, clock)?;
    let task = (seed, config.run.period_ns());
    let mut source = SourcePlanner::new(config)?;
    let mut found = None;
    let mut last = 0;
    drive(&mut world, &mut driver, task, |tick| {
        last = tick.observation.header.tick;
        if last < wanted {
            source.planner.plan(tick.observation, &mut source.plan);
        } else if last == wanted {
            found = Some(Box::new(*tick.observation));
        }
    })?;
    let driver = arguments.driver.word();
    let observation = found
        .ok_or_else(|| anyhow!("--tick {wanted}: with {driver}, seed {seed} ends at {last}"))?;
    let title = format!("Plan of seed {seed}, tick {wanted}");
    Ok(source.finish(observation, title, format!("{seed}-{wanted}")))
}

/// Plans again for the newest observation of a running run.
fn of_run(name: &RunName, clock: Clock) -> anyhow::Result<Planned> {
    let paths = RunPaths::new(name.clone());
    // Refuses a folder of another user, with its owner.
    if paths.holder()?.is_none() {
        return Err(Failure::GivenUp(format!(
            "run '{name}' is not running; `./vlaps up --run {name}` starts it"
        ))
        .into());
    }
    // A place that is being cleaned is not joined.
    let is_open = paths.supervisor_pid().is_some();
    let config = config::load(&paths.config_file()).ok().filter(|_| is_open);
    let config = config.ok_or_else(|| {
        Failure::GivenUp(format!(
            "run '{name}' is just starting or ending; try again"
        ))
    })?;
    let step = newest_step(name, clock);
    // If the run has ended meanwhile, this process is its last member and removes its files.
    if paths.supervisor_pid().is_none() {
        clean_run(&paths)?;
    }
    let step = step?;
    let observation = Box::new(step.observation);
    let title = format!("Run '{name}', tick {}", observation.header.tick);
    let mut source = SourcePlanner::new(config)?;
    // A planner with memory would continue from the previous plan, which is not stored;
    // this one begins without memory.
    source.planner.forget();
    Ok(source.finish(observation, title, name.to_string()))
}

/// The newest step of a run.
fn newest_step(name: &RunName, clock: Clock) -> anyhow::Result<Box<Step>> {
    let wire = Wire::join(name, Process::Supervisor)?;
    let mut steps = wire.latest(STEP)?;
    let begin = clock();
    while clock().since_ns(begin) < LISTEN_NS {
        steps.update_connections();
        // The first steps may have no observation yet.
        let seen = |step: &Step| step.observation_age_ns != u64::MAX;
        if let Some(step) = steps.newest(Message::check).filter(seen) {
            return Ok(Box::new(step));
        }
        pause(LOOK);
    }
    Err(Failure::GivenUp(format!(
        "run '{name}' has taken no step within {} s; `./vlaps status` shows its state",
        LISTEN_NS / 1_000_000_000
    ))
    .into())
}
