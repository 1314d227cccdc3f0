//! How long a plan takes and how good it is, on recorded scenes and one core;
//! beside OMPL on request.

mod compare;
mod ompl;
mod timing;

use std::time::Duration;

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use serde::Serialize;
use shm_config::counted;

use crate::arguments::BenchPlanner;
use crate::report::{Machine, say, write_json};
use crate::scene::{self, Recording, Scene};
use crate::{Clock, settings};

pub use compare::{Comparison, Point, Side};
pub use timing::{Row, Times};

/// How time is read: handed in by `main.rs`.
#[derive(Clone, Copy)]
pub struct Clocks {
    /// Time on the machine's clock.
    pub wall: Clock,
    /// Processor time of the calling thread so far.
    pub core: fn() -> Duration,
}

/// The project's bar for the whole plan of the paper's method, p99.
const BAR_PLAN_US: f64 = 250.0;

/// All measurements of a run; the JSON object of `--json`.
#[derive(Clone, Debug, Serialize)]
pub struct Planning {
    /// One for each planner.
    pub rows: Vec<Row>,
    /// The paper's planner beside OMPL's; none unless asked for.
    pub ompl: Option<Comparison>,
    /// How it was measured.
    pub conditions: Conditions,
}

/// How it was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Conditions {
    /// The file the scenes are from.
    pub scene_file: String,
    /// How many scenes.
    pub scenes: usize,
    /// How often each is planned for.
    pub rounds: u32,
    /// The core that everything ran on.
    pub core: usize,
    /// The machine.
    #[serde(flatten)]
    pub machine: Machine,
}

/// `./vlaps bench planner`.
///
/// # Errors
/// When the configuration or the scenes are wrong, a file cannot be written, or
/// OMPL is asked for and missing.
pub fn bench(arguments: &BenchPlanner, clocks: Clocks) -> anyhow::Result<()> {
    let chosen = &arguments.configuration;
    let config = settings::config(chosen.config.as_deref(), &chosen.overrides)?;
    if let Some(path) = &arguments.record {
        let recording = Recording {
            first_seed: arguments.first_seed,
            episodes: arguments.episodes,
            scenes: arguments.keep as usize,
        };
        let bar = progress(2 * arguments.episodes, "drives")?;
        let scenes = scene::record(recording, &config, clocks.wall, || bar.inc(1))?;
        bar.finish_and_clear();
        scene::write(path, &scenes)?;
        say(format_args!("{}: {} scenes", path.display(), scenes.len()));
        return Ok(());
    }
    let (scene_file, scenes) = match &arguments.scenes {
        Some(path) => (path.display().to_string(), scene::read(path)?),
        None => (scene::CHECKED_IN_NAME.into(), scene::checked_in()?),
    };
    // Before anything is measured: what is missing is said at once.
    let ompl = arguments.ompl.then(ompl::build).transpose()?;
    let conditions = Conditions {
        scene_file,
        scenes: scenes.len(),
        rounds: arguments.rounds,
        machine: Machine::here()?,
        core: stay_on_one_core()?,
    };
    say(format_args!(
        "{} of {}, {}, on core {}; {}",
        counted(conditions.scenes as u64, "scene"),
        conditions.scene_file,
        counted(conditions.rounds, "round"),
        conditions.core,
        conditions.machine
    ));
    let rows = time_all(&scenes, &config, arguments.rounds, clocks)?;
    let ompl = match &ompl {
        Some(program) => Some(compare_with(program, &scenes, arguments.rounds, clocks)?),
        None => None,
    };
    let planning = Planning {
        rows,
        ompl,
        conditions,
    };
    match &arguments.json {
        Some(path) => write_json(path, &planning),
        None => Ok(()),
    }
}

fn time_all(
    scenes: &[Scene],
    config: &shm_config::config::Config,
    rounds: u32,
    clocks: Clocks,
) -> anyhow::Result<Vec<Row>> {
    let bar = progress(timing::turns(scenes, rounds), "plans")?;
    let rows = timing::measure(scenes, config, rounds, clocks, |count| bar.inc(count))?;
    bar.finish_and_clear();
    say(timing::table(&rows));
    say("p50 / p99 / p99.9 / max; all times of all rounds are in it, the first ones too");
    if let Some(paper) = rows.first() {
        say(format_args!(
            "{}: whole plan p99 {:.0} us, bar {BAR_PLAN_US}: {}; {:.0} us by processor time",
            paper.planner,
            paper.plan.p99_us,
            met(paper.plan.p99_us < BAR_PLAN_US),
            paper.core.p99_us,
        ));
    }
    Ok(rows)
}

fn compare_with(
    program: &ompl::Program,
    scenes: &[Scene],
    rounds: u32,
    clocks: Clocks,
) -> anyhow::Result<Comparison> {
    let bar = progress(compare::turns(scenes, rounds), "plans of both")?;
    let comparison =
        compare::compare(program, scenes, rounds, clocks.wall, |count| bar.inc(count))?;
    bar.finish_and_clear();
    comparison.print();
    Ok(comparison)
}

fn progress(length: u64, what: &str) -> anyhow::Result<ProgressBar> {
    let style = format!("{{elapsed_precise}} {{wide_bar}} {{pos}}/{{len}} {what}, {{eta}} left");
    let bar = ProgressBar::new(length);
    bar.set_style(ProgressStyle::with_template(&style)?);
    Ok(bar)
}

/// A bar's word.
fn met(met: bool) -> &'static str {
    match met {
        true => "met",
        false => "MISSED",
    }
}

/// Keeps this thread, and the programs it starts, on the last core it may use;
/// the first one answers most interrupts.
fn stay_on_one_core() -> anyhow::Result<usize> {
    let allowed = sched_getaffinity(None).context("the cores of this process")?;
    let Some(core) = (0..CpuSet::MAX_CPU)
        .rev()
        .find(|&core| allowed.is_set(core))
    else {
        bail!("this process may use no core");
    };
    let mut cores = CpuSet::new();
    cores.set(core);
    sched_setaffinity(None, &cores).with_context(|| format!("staying on core {core}"))?;
    Ok(core)
}
