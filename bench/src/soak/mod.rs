//! `bench soak`: drives a process set in lockstep for millions of ticks and checks
//! whether any process grows.

mod figure;
mod sample;
mod verdict;

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use supervisor::subcommand::{Output, Subcommand};

use anyhow::{Context, bail};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use shm_config::message::Message;
use shm_config::run::RunPaths;
use supervisor::cli::parsers::whole;

use crate::driven::Driven;
use lab::report::Machine;
use lab::stop::Stop;
use sample::Sample;
use stack::Clock;
use supervisor::subcommand::settings;
use supervisor::subcommand::write_json_option;
use verdict::{Flatness, Rule};

/// Drive a set in lockstep for millions of ticks and check whether any process grows
#[derive(Debug, Args)]
#[command(
    after_help = "Every process of the set is sampled: memory (anonymous and resident), open files \
        and threads; of the run, its files in shared memory. The first fifth of the ticks, and \
        60,000 ticks at least, is warm-up. A process is flat if, over the remaining ticks, the \
        Theil-Sen slope of its anonymous memory is within the limit, the median of the last tenth \
        exceeds that of the first by no more than another limit, it holds no more files or threads \
        at the end than at the begin, and it was not restarted. Of shared memory, the length of the files does not grow at all; how much of it is \
        used follows the readers, and may grow beyond that limit if it reaches a new maximum in no \
        more than five tenths of the ticks. The supervisor may grow by its list of episodes. samples.csv, memory.svg and memory.png go to --out. Exit code 1 when a process \
        is not flat or the soak was stopped: after Ctrl-C the verdict covers the samples so far.\n\n\
        Examples:\n  \
        ./vlaps bench soak --ticks 100000\n  \
        ./vlaps bench soak --ticks 10000000 --out soak --json soak.json\n  \
        ./vlaps bench soak --ticks 1000000 --set learner.enabled=true"
)]
pub struct BenchSoak {
    /// Number of ticks, 70,000 at least: 60,000 are warm-up.
    #[arg(long, value_name = "N", default_value_t = 10_000_000,
          allow_negative_numbers = true,
          value_parser = whole::<u64>(TICKS_MIN..=1_000_000_000))]
    pub ticks: u64,
    /// Seed of the first episode.
    #[arg(long, value_name = "N", default_value_t = 3, allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=i64::MAX as u64))]
    pub seed: u64,
    /// Maximum number of samples, spread evenly over the ticks.
    #[arg(long, value_name = "N", default_value_t = 1_000, allow_negative_numbers = true,
          value_parser = whole::<u64>(20..=2_000))]
    pub samples: u64,
    /// Override any key of the configuration, such as gate.mode=rules; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Folder for the samples and the plot.
    #[arg(long, value_name = "DIR", default_value = "soak")]
    pub out: PathBuf,
    /// Also write the verdict to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Minimum number of ticks: the warm-up and enough ticks for a verdict.
const TICKS_MIN: u64 = verdict::WARM_UP_TICKS_MIN + 10_000;
/// Keys that a soak sets itself, and the option that changes them.
const OWN_KEYS: [(&str, &str); 6] = [
    ("run.name", ""),
    ("run.folder", ""),
    ("run.clock", ""),
    ("run.seed", "--seed"),
    ("run.episodes", "--ticks"),
    ("run.duration_s", "--ticks"),
];
/// Polling interval of the tick.
const LOOK: Duration = Duration::from_millis(100);

/// Result of a soak.
#[derive(Clone, Debug, Serialize)]
pub struct SoakResults {
    /// Whether every process was flat.
    pub is_flat: bool,
    /// Whether it was stopped early; the figures cover the ticks until then.
    pub was_stopped: bool,
    /// Measurements of each process and of the run's shared memory.
    pub rows: Vec<Flatness>,
    /// The criteria for flat.
    pub rule: Rule,
    /// Ticks driven.
    pub ticks: u64,
    /// Ticks that the world skipped; 0 in lockstep.
    pub skipped: u64,
    /// Episodes driven.
    pub episodes: u64,
    /// Restarts of processes.
    pub restarts: u64,
    /// Wall-clock time, s.
    pub wall_s: f64,
    /// Samples taken.
    pub samples: u64,
    /// The machine.
    pub conditions: Machine,
}

impl Subcommand for BenchSoak {
    fn outputs(&self) -> Vec<Output> {
        vec![
            Output::Folder("--out", Some(self.out.clone())),
            Output::json(&self.json),
        ]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        bench(self, clock)
    }
}

/// `./vlaps bench soak`.
///
/// # Errors
/// If the set does not start or fails, is not flat or was stopped, or a file cannot be
/// written.
fn bench(arguments: &BenchSoak, clock: Clock) -> anyhow::Result<ExitCode> {
    settings::refuse_own(&arguments.overrides, &OWN_KEYS)?;
    let conditions = Machine::here()?;
    std::fs::create_dir_all(&arguments.out).with_context(|| arguments.out.display().to_string())?;
    let stop = Stop::listen()?;
    let begun = clock();
    let mut driven = start(arguments)?;
    let samples = watch(arguments, &mut driven, &stop, clock)?;
    let summary = driven.finish()?;
    let wall_s = clock().since_ns(begun) as f64 * 1e-9;
    let count = |key: &str| summary[key].as_u64().unwrap_or(0);
    let episodes = summary["episodes"].as_array().map_or(0, Vec::len) as u64;
    let (ticks, restarts) = (count("ticks"), count("restarts"));
    let was_stopped = stop.is_asked() && ticks < arguments.ticks;
    let planned = if was_stopped { ticks } else { arguments.ticks };
    let rule = Rule::of(planned, episodes);
    let rows = verdict::rows(&samples, &rule).with_context(|| match was_stopped {
        true => format!("stopped after {ticks} of {} ticks", arguments.ticks),
        false => arguments.out.join(SAMPLES).display().to_string(),
    })?;
    let results = SoakResults {
        is_flat: rows.iter().all(|row| row.is_flat) && restarts == 0 && ticks >= planned,
        was_stopped,
        rows,
        rule,
        ticks,
        skipped: count("skipped"),
        episodes,
        restarts,
        wall_s,
        samples: samples.len() as u64,
        conditions,
    };
    figure::draw(&samples, &results, &arguments.out)?;
    verdict::print(&results);
    write_json_option(&arguments.json, &results)?;
    let word = if results.is_flat { "flat" } else { "not flat" };
    let path = arguments.out.join(SAMPLES);
    match (results.is_flat, results.was_stopped) {
        (true, false) => Ok(ExitCode::SUCCESS),
        (false, false) => bail!("{word}; the samples are in {}", path.display()),
        (_, true) => bail!(
            "stopped after {ticks} of {} ticks, {word} so far; the samples are in {}",
            arguments.ticks,
            path.display()
        ),
    }
}

fn start(arguments: &BenchSoak) -> anyhow::Result<Driven> {
    let config = settings::config([None, None], &arguments.overrides)?;
    // One tick more: the run's end must not cut off the last tick.
    let duration_s = (arguments.ticks + 1) as f64 * config.run.period_ns() as f64 * 1e-9;
    let mut up: Vec<std::ffi::OsString> = vec!["--lockstep".into(), "--episodes".into()];
    up.extend([
        "0".into(),
        "--duration".into(),
        duration_s.to_string().into(),
    ]);
    up.extend(["--seed".into(), arguments.seed.to_string().into()]);
    for text in &arguments.overrides {
        up.extend(["--set".into(), text.into()]);
    }
    Driven::start("soak", up)
}

/// The file of samples.
const SAMPLES: &str = "samples.csv";

/// Takes samples until the end or until a stop is requested. Each is written at once: an
/// interrupted soak keeps its samples.
fn watch(
    arguments: &BenchSoak,
    driven: &mut Driven,
    stop: &Stop,
    clock: Clock,
) -> anyhow::Result<Vec<Sample>> {
    let paths = RunPaths::new(driven.name().parse()?);
    let (_wire, mut progress) = driven.listen(clock)?;
    let path = arguments.out.join(SAMPLES);
    let named = || path.display().to_string();
    let mut file = BufWriter::new(File::create(&path).with_context(named)?);
    writeln!(file, "{}", Sample::HEADER).with_context(named)?;
    let bar = ProgressBar::new(arguments.ticks);
    bar.set_style(ProgressStyle::with_template(
        "{elapsed_precise} {wide_bar} {pos}/{len} ticks, {eta} left",
    )?);
    let step = (arguments.ticks / arguments.samples).max(1);
    let (mut samples, mut due, mut stopping) = (Vec::new(), step, false);
    while !driven.has_ended()? {
        if stop.is_asked() && !stopping {
            // Only once: a second signal would kill the set.
            driven.stop();
            stopping = true;
        }
        if let Some(progress) = progress.newest(Message::check) {
            let tick = progress.header.tick;
            bar.set_position(tick);
            // No samples near the end: processes that are ending release their memory.
            if tick >= due && tick < arguments.ticks && !stopping {
                let sample = Sample::take(tick, driven.pid(), &paths)?;
                sample.write(&mut file).with_context(named)?;
                samples.push(sample);
                due = tick + step;
            }
        }
        progress.update_connections();
        supervisor::machine::signals::pause(LOOK);
    }
    bar.finish_and_clear();
    Ok(samples)
}
