//! `./vlaps eval`.

mod shards;

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, ensure};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use shm_config::config::Simulator;
use shm_config::counted;
use stack::Clock;
use stack::driver::DriverKind;
use supervisor::cli::parsers::whole;
use supervisor::commands::up::arguments::SimulatorAlone;
use supervisor::setup::foreign::Foreign;
use supervisor::subcommand::{Configuration, Output, Subcommand, say, write_json_option};
use view::draw::failures;

use crate::episodes::{Task, evaluate};
use crate::evaluation::Evaluation;
use crate::metric::FOOTNOTE;
use crate::outcomes::{Comparison, Maps, Outcomes, WorldSettings};
use crate::progress::left;
use crate::shard::{Shard, needs_shard};

/// Drive many episodes and print success, contacts and completion.
#[derive(Debug, Args)]
#[command(
    after_help = "Each episode depends only on its seed: the figures do not depend on the number of \
        threads. The expert consists of the same planner and controller as in \
        `./vlaps up --lockstep --gate expert` and gives the same commands; rrt-star, informed, \
        kinodynamic and mpc are the expert with that planner.method.\n\n\
        --shard I/N drives the I-th of N parts, on any machine, and keeps each episode in --out as \
        soon as it ends; the same command continues after Ctrl-C or a kill. --report merges the \
        parts in --out and says which are missing (exit code 1); with all of them the figures are \
        those of one piece, bit by bit, but for the planning time.\n\n\
        --against FILE counts the maps on which one of two drivers alone succeeds; p is the \
        probability of so uneven a split, or a more uneven one, between equally good drivers. A \
        file with other settings of [world] is refused. Files of earlier versions, and of other \
        worlds than sim and metadrive, do not contain them: the output says so.\n\n\
        Examples:\n  \
        ./vlaps eval --driver expert --episodes 1000\n  \
        ./vlaps eval --driver mpc --episodes 200\n  \
        ./vlaps eval --driver policy.onnx --episodes 200\n  \
        ./vlaps eval --driver idm --first-seed 100 --episodes 50 --json idm.json\n  \
        ./vlaps eval --driver mpc --first-seed 100 --episodes 50 --against idm.json\n  \
        ./vlaps eval --driver expert --world metadrive --episodes 50\n  \
        ./vlaps eval --driver mpc --episodes 8000 --shard 3/8 --out runs/mpc\n  \
        ./vlaps eval --out runs/mpc --report --json mpc.json"
)]
pub struct Eval {
    /// Driver: expert, rrt-star, informed, kinodynamic, mpc, lane, idm, or a policy file
    /// (FILE.onnx), which then drives alone.
    #[arg(long, value_name = "DRIVER", default_value = "expert")]
    pub driver: DriverKind,
    /// Number of episodes.
    #[arg(long, value_name = "N", default_value_t = 1000,
          allow_negative_numbers = true,
          value_parser = whole::<u64>(1..=1_000_000))]
    pub episodes: u64,
    /// Seed of the first episode; each following episode adds one.
    #[arg(long, value_name = "N", default_value_t = 1000, allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub first_seed: u64,
    /// World to drive in.
    #[arg(long, value_name = "WORLD", default_value = "sim",
          value_parser = SimulatorAlone)]
    pub world: Simulator,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
    /// Number of threads; default: the number of cores. In worlds other than
    /// sim, each thread runs a simulator of its own.
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub threads: Option<NonZeroUsize>,
    /// Draw failed episodes into this folder, at most 50; they are driven again in the
    /// built-in world.
    #[arg(long, value_name = "DIR")]
    pub draw: Option<PathBuf>,
    /// Drive part I of N of the episodes, such as 3/8, and keep them in --out.
    #[arg(long, value_name = "I/N", requires = "out", conflicts_with_all = ["draw", "json"])]
    pub shard: Option<Shard>,
    /// Folder of the parts; it may be shared by machines, or be copied together.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Do not drive: merge the parts in --out and print the figures.
    #[arg(long, requires = "out", conflicts_with_all = ["shard", "draw", "driver", "episodes",
          "first_seed", "world", "threads", "config", "vehicle", "overrides"])]
    pub report: bool,
    /// Compare map by map with the figures in this file, by the sign test: those of an
    /// evaluation of the same seeds (--json), or the final.json or held-back.json of a
    /// training. For work in parts, give it to --report.
    #[arg(long, value_name = "FILE", conflicts_with = "shard")]
    pub against: Option<PathBuf>,
    /// Also write the figures to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Subcommand for Eval {
    fn outputs(&self) -> Vec<Output> {
        vec![
            Output::Folder("--draw", self.draw.clone()),
            // A report of a folder that is missing makes none.
            Output::Folder("--out", self.shard.and(self.out.clone())),
            Output::json(&self.json),
        ]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        match (&self.out, self.report, self.shard) {
            (Some(out), true, _) => return shards::report(self, out),
            (Some(_), false, None) => {
                return Err(needs_shard());
            }
            (_, _, _) => {}
        }
        let config = self.configuration.resolve()?;
        let cores = std::thread::available_parallelism()?;
        // Further threads would wait for a core or have no episode.
        let of_use = cores.min(NonZeroUsize::try_from(self.episodes as usize)?);
        let asked = self.threads.unwrap_or(of_use);
        let task = Task {
            driver: self.driver,
            world: self.world,
            first_seed: self.first_seed,
            episodes: self.episodes,
            threads: asked.min(of_use),
        };
        let settings = WorldSettings::of(&config.world, task.world);
        let earlier = self.earlier(&task, &settings)?;
        if let (Some(shard), Some(out)) = (self.shard, &self.out) {
            shards::drive(self, (shard, out), (&task, &config), clock)?;
            return Ok(ExitCode::SUCCESS);
        }
        let bar = ProgressBar::new(task.episodes);
        let style = "{elapsed_precise} {wide_bar} {pos}/{len} episodes, {left}";
        bar.set_style(ProgressStyle::with_template(style)?.with_key("left", left(0)));
        let begun = clock();
        let drives = evaluate(&task, &config, clock, |_| bar.inc(1))?;
        let elapsed_s = clock().since_ns(begun) as f64 * 1e-9;
        bar.finish_and_clear();
        let evaluation = Evaluation::new(&task, settings, &drives);
        let last_seed = task.first_seed.wrapping_add(task.episodes - 1);
        say(format_args!(
            "{} in {}, seeds {} to {last_seed}: {} on {} in {elapsed_s:.1} s",
            task.driver.word(),
            Foreign::name_of(task.world),
            task.first_seed,
            counted(task.episodes, "episode"),
            counted(task.threads.get() as u64, "thread")
        ));
        if asked > of_use {
            say(format_args!(
                "--threads {asked}: with {} and {} only {of_use} can run",
                counted(cores.get() as u64, "core"),
                counted(task.episodes, "episode")
            ));
        }
        print(&evaluation);
        let compared = earlier.map(|earlier| compare(earlier, &evaluation));
        let against = compared.transpose()?;
        if let Some(folder) = &self.draw {
            let seeds: Vec<u64> = evaluation
                .failures
                .iter()
                .map(|failure| failure.seed)
                .collect();
            let drawn = (&seeds[..], task.driver);
            failures((folder, DRAWN_MAX), drawn, &config, clock)?;
        }
        let figures = &evaluation;
        write_json_option(&self.json, &Compared { figures, against })?;
        Ok(ExitCode::SUCCESS)
    }
}

/// The JSON object of an evaluation, with its comparison.
#[derive(Serialize)]
struct Compared<'a> {
    #[serde(flatten)]
    figures: &'a Evaluation,
    #[serde(skip_serializing_if = "Option::is_none")]
    against: Option<Comparison>,
}

impl Eval {
    /// What `--against` names, before hours of driving.
    fn earlier(
        &self,
        task: &Task,
        settings: &Option<WorldSettings>,
    ) -> anyhow::Result<Option<(&Path, Outcomes)>> {
        let Some(file) = &self.against else {
            return Ok(None);
        };
        let maps = Maps {
            world: task.world.word().into(),
            first_seed: task.first_seed,
            episodes: task.episodes,
            settings: settings.clone(),
        };
        let read = Outcomes::read(file).and_then(|earlier| {
            earlier.check_maps(&maps)?;
            let written = self.json.as_ref().and_then(|json| json.canonicalize().ok());
            ensure!(
                written.is_none_or(|json| file.canonicalize().ok() != Some(json)),
                "--json would write over it"
            );
            Ok(earlier)
        });
        let earlier = read.with_context(|| format!("--against {}", file.display()))?;
        Ok(Some((file, earlier)))
    }
}

/// Compares with an earlier evaluation and prints it.
fn compare(
    (file, earlier): (&Path, Outcomes),
    evaluation: &Evaluation,
) -> anyhow::Result<Comparison> {
    let this = Outcomes::of(&serde_json::to_value(evaluation)?)?;
    let compared = Comparison::new(&this, &earlier)?;
    let doubt = match earlier.tells_settings() {
        true => "",
        false => " (which does not contain the settings of its world: its maps may differ)",
    };
    say(format_args!(
        "map by map, against {} of {}{doubt}:",
        compared.driver,
        file.display()
    ));
    say(compared.table());
    Ok(compared)
}

/// Prints the figures and the failures.
fn print(evaluation: &Evaluation) {
    say(evaluation.table());
    say(FOOTNOTE);
    if let Some(failures) = evaluation.failure_table() {
        say("failures by the strict metric, with their seeds:");
        say(failures);
    }
}

/// Maximum number of failures that are drawn.
const DRAWN_MAX: usize = 50;
