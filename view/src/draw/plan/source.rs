//! Where the plan that is drawn is from: an episode, a recorded scene, a run.

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

/// How long a run has to take a step, ns; ten periods and more.
const LISTEN_NS: u64 = 2_000_000_000;
/// From look to look.
const LOOK: Duration = Duration::from_millis(20);

/// The plan that the command line asks for.
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
        let mut begun = Begun::new(config)?;
        scene.prepare(&mut begun.planner, &mut begun.plan);
        let (seed, tick) = (scene.origin.seed, scene.observation.header.tick);
        let title = format!("Scene {}: seed {seed}, tick {tick}", arguments.index);
        let name = format!("scene-{}", arguments.index);
        return Ok(begun.finish(scene.observation, title, name));
    }
    of_episode(arguments, config, clock)
}

/// A planner under way.
struct Begun {
    config: Config,
    planner: Planner,
    plan: Box<Plan>,
}

impl Begun {
    fn new(config: Config) -> anyhow::Result<Begun> {
        Ok(Begun {
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

/// Drives an episode up to a tick. A planner of its own plans for each tick, so
/// that one with a memory remembers what the driver's remembers.
fn of_episode(arguments: &DrawPlan, config: Config, clock: Clock) -> anyhow::Result<Planned> {
    let (Some(seed), Some(wanted)) = (arguments.seed, arguments.tick) else {
        bail!("--seed needs a --tick");
    };
    let mut world = World::new(WorldConfig::from(&config.world))?;
    let mut driver = EpisodeDriver::new(arguments.driver, &config, clock)?;
    let task = (seed, config.run.period_ns());
    let mut begun = Begun::new(config)?;
    let mut found = None;
    let mut last = 0;
    drive(&mut world, &mut driver, task, |tick| {
        last = tick.observation.header.tick;
        if last < wanted {
            begun.planner.plan(tick.observation, &mut begun.plan);
        } else if last == wanted {
            found = Some(Box::new(*tick.observation));
        }
    })?;
    let who = arguments.driver.word();
    let observation =
        found.ok_or_else(|| anyhow!("--tick {wanted}: with {who}, seed {seed} ends at {last}"))?;
    let title = format!("Plan of seed {seed}, tick {wanted}");
    Ok(begun.finish(observation, title, format!("{seed}-{wanted}")))
}

/// Plans again for what a living run saw last.
fn of_run(name: &RunName, clock: Clock) -> anyhow::Result<Planned> {
    let paths = RunPaths::new(name.clone());
    // A folder of that name that is another user's is refused here, with its owner.
    if paths.holder()?.is_none() {
        return Err(Failure::GivenUp(format!(
            "run '{name}' is not running; `./vlaps up --run {name}` starts it"
        ))
        .into());
    }
    let config = config::load(&paths.config_file()).map_err(|_| {
        Failure::GivenUp(format!(
            "run '{name}' is just starting or ending; try again"
        ))
    })?;
    let heard = hear(name, clock);
    // The run may have ended meanwhile; then this process kept its place.
    if paths.supervisor_pid().is_none() {
        clean_run(&paths)?;
    }
    let step = heard?;
    let observation = Box::new(step.observation);
    let title = format!("Run '{name}', tick {}", observation.header.tick);
    let mut begun = Begun::new(config)?;
    // A planner with a memory continues from the plan of the step before, which
    // is not stored; this one begins with this observation.
    begun.planner.forget();
    Ok(begun.finish(observation, title, name.to_string()))
}

/// The newest step of a run.
fn hear(name: &RunName, clock: Clock) -> anyhow::Result<Box<Step>> {
    let wire = Wire::join(name, Process::Supervisor)?;
    let mut steps = wire.latest(STEP)?;
    let begun = clock();
    while clock().since_ns(begun) < LISTEN_NS {
        steps.update_connections();
        // A step without an observation has never had one.
        let seen = |step: &Step| step.observation_age_ns != u64::MAX;
        if let Some(step) = steps.newest(Message::check).filter(seen) {
            return Ok(Box::new(step));
        }
        pause(LOOK);
    }
    Err(Failure::GivenUp(format!(
        "run '{name}' has taken no step within {} s; `./vlaps status` says how it does",
        LISTEN_NS / 1_000_000_000
    ))
    .into())
}
