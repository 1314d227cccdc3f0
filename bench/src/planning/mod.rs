//! Planning time and path cost on recorded scenes and one core; compared with OMPL on
//! request.

mod compare;
mod ompl;
mod timing;

use crate::gauges::Gauges;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use supervisor::cli::parsers::whole;
use supervisor::subcommand::{Configuration, Output, Subcommand};

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use serde::Serialize;
use shm_config::counted;

use lab::report::Machine;
use stack::Clock;
use stack::scene::{self, Recording, Scene};
use supervisor::subcommand::{say, write_json_option};

pub use compare::{Comparison, Point, Side};
pub use timing::{Row, Times};

/// Measure planning time and path cost, and compare with OMPL.
#[derive(Debug, Args)]
#[command(
    after_help = "A scene is an observation from a real episode of the built-in world; \
        stack/scenes/README.md describes the file format, so that you can provide your own. \
        RRT* always uses the paper's parameters, the other planners those of the configuration. \
        --ompl builds bench/ompl with g++ and libompl-dev.\n\n\
        Examples:\n  \
        ./vlaps bench planner --json planner.json\n  \
        ./vlaps bench planner --ompl\n  \
        ./vlaps bench planner --record scenes.jsonl.gz --first-seed 100 --episodes 50\n  \
        ./vlaps bench planner --scenes scenes.jsonl.gz"
)]
pub struct BenchPlanner {
    /// Scenes to plan for; default: the checked-in ones.
    #[arg(long, value_name = "FILE")]
    pub scenes: Option<PathBuf>,
    /// Number of plans for each scene.
    #[arg(long, value_name = "N", default_value_t = 10,
          allow_negative_numbers = true,
          value_parser = whole::<u32>(1..=10_000))]
    pub rounds: u32,
    /// Also compare the paper's planner with OMPL's RRTstar.
    #[arg(long)]
    pub ompl: bool,
    /// Instead of measuring, drive episodes and record scenes into this file.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["scenes", "rounds", "ompl", "json"])]
    pub record: Option<PathBuf>,
    /// Seed of the first recorded episode; each following episode adds one.
    #[arg(long, value_name = "N", default_value_t = 100, requires = "record",
          allow_negative_numbers = true, value_parser = whole::<u64>(0..=u64::MAX))]
    pub first_seed: u64,
    /// Number of episodes to record.
    #[arg(long, value_name = "N", default_value_t = 50, requires = "record",
          allow_negative_numbers = true,
          value_parser = whole::<u64>(1..=100_000))]
    pub episodes: u64,
    /// Number of scenes to keep.
    #[arg(long, value_name = "N", default_value_t = 600, requires = "record",
          allow_negative_numbers = true,
          value_parser = whole::<u32>(1..=1_000_000))]
    pub keep: u32,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
    /// Also write the rows to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Subcommand for BenchPlanner {
    fn outputs(&self) -> Vec<Output> {
        vec![
            Output::File("--record", self.record.clone()),
            Output::json(&self.json),
        ]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let gauges = Gauges::new(clock);
        let config = self.configuration.resolve()?;
        if let Some(path) = &self.record {
            let recording = Recording {
                first_seed: self.first_seed,
                episodes: self.episodes,
                scenes: self.keep as usize,
            };
            let bar = progress(2 * self.episodes, "drives")?;
            let scenes = scene::record(recording, &config, gauges.clock(), || bar.inc(1))?;
            bar.finish_and_clear();
            scene::write(path, &scenes)?;
            say(format_args!("{}: {} scenes", path.display(), scenes.len()));
            return Ok(ExitCode::SUCCESS);
        }
        let (scene_file, scenes) = match &self.scenes {
            Some(path) => (path.display().to_string(), scene::read(path)?),
            None => (scene::CHECKED_IN_NAME.into(), scene::checked_in()?),
        };
        // Checked before the measurement, so that a missing program is reported at once.
        let ompl = self.ompl.then(ompl::build).transpose()?;
        let conditions = Conditions {
            scene_file,
            scenes: scenes.len(),
            rounds: self.rounds,
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
        let rows = time_all(&scenes, &config, self.rounds, gauges)?;
        let ompl = match &ompl {
            Some(program) => Some(compare_with(program, &scenes, self.rounds, gauges)?),
            None => None,
        };
        let planning = Planning {
            rows,
            ompl,
            conditions,
        };
        write_json_option(&self.json, &planning)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// The project's target for a whole plan of the paper's method, 99 % quantile.
const BAR_PLAN_US: f64 = 250.0;

/// All measurements; the JSON object of `--json`.
#[derive(Clone, Debug, Serialize)]
pub struct Planning {
    /// One row per planner.
    pub rows: Vec<Row>,
    /// The paper's planner beside OMPL's; `None` unless requested.
    pub ompl: Option<Comparison>,
    /// Conditions of the measurement.
    pub conditions: Conditions,
}

/// Conditions of the measurement.
#[derive(Clone, Debug, Serialize)]
pub struct Conditions {
    /// File of the scenes.
    pub scene_file: String,
    /// Number of scenes.
    pub scenes: usize,
    /// Plans per scene.
    pub rounds: u32,
    /// The core of all planners.
    pub core: usize,
    /// The machine.
    #[serde(flatten)]
    pub machine: Machine,
}

fn time_all(
    scenes: &[Scene],
    config: &shm_config::config::Config,
    rounds: u32,
    gauges: Gauges,
) -> anyhow::Result<Vec<Row>> {
    let bar = progress(timing::turns(scenes, rounds), "plans")?;
    let rows = timing::measure(scenes, config, rounds, gauges, |count| bar.inc(count))?;
    bar.finish_and_clear();
    say(timing::table(&rows));
    say("p50 / p99 / p99.9 / max; all rounds are counted, including the first");
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
    gauges: Gauges,
) -> anyhow::Result<Comparison> {
    let bar = progress(compare::turns(scenes, rounds), "plans of both")?;
    let comparison = compare::compare(program, scenes, rounds, gauges.clock(), |count| {
        bar.inc(count)
    })?;
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

/// The word for a target that is met or missed.
fn met(met: bool) -> &'static str {
    match met {
        true => "met",
        false => "MISSED",
    }
}

/// Pins this thread, and the programs that it starts, to the last core that it may
/// use: the first core handles most interrupts.
fn stay_on_one_core() -> anyhow::Result<usize> {
    let allowed = sched_getaffinity(None).context("the cores of this process")?;
    let Some(core) = (0..CpuSet::MAX_CPU)
        .rev()
        .find(|&core| allowed.is_set(core))
    else {
        bail!("this process may not use any core");
    };
    let mut cores = CpuSet::new();
    cores.set(core);
    sched_setaffinity(None, &cores).with_context(|| format!("pinning to core {core}"))?;
    Ok(core)
}
