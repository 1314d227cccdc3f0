//! `bench soak`: a real process set in lockstep for millions of ticks. Does any
//! process grow?

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
use shm_config::message::{Message, Progress};
use shm_config::run::RunPaths;
use shm_config::services::{PROGRESS, Process};
use shm_config::wire::{Subscriber, Wire};
use supervisor::cli::parsers::whole;

use crate::driven::Driven;
use lab::report::Machine;
use lab::stop::Stop;
use sample::Sample;
use stack::Clock;
use supervisor::subcommand::settings;
use supervisor::subcommand::write_json_option;
use verdict::{Flatness, Rule};

/// Drive a set in lockstep for millions of ticks: does any process grow?
#[derive(Debug, Args)]
#[command(
    after_help = "Every process of the set is looked at again and again: memory (anonymous and \
        resident), open files, threads; of the run, its files in shared memory. The first fifth, \
        and 60,000 ticks at least, is for warming up. Flat means: over the rest, the Theil-Sen slope of the anonymous memory is \
        within the limit, the median of the last tenth is not above that of the first by more than \
        another limit, no process holds more files or threads at the end than at the begin, and none \
        was restarted. The supervisor may grow by its list of episodes. samples.csv, memory.svg and \
        memory.png go to --out; exit 1 when it is not flat, or was stopped: Ctrl-C ends a soak with \
        the verdict on its samples so far.\n\n\
        Examples:\n  \
        ./vlaps bench soak --ticks 100000\n  \
        ./vlaps bench soak --ticks 10000000 --out soak --json soak.json\n  \
        ./vlaps bench soak --ticks 1000000 --set learner.enabled=true"
)]
pub struct BenchSoak {
    /// How many ticks, 70,000 at least: 60,000 are for warming up.
    #[arg(long, value_name = "N", default_value_t = 10_000_000,
          allow_negative_numbers = true,
          value_parser = whole::<u64>(TICKS_MIN..=1_000_000_000))]
    pub ticks: u64,
    /// Seed of the first episode.
    #[arg(long, value_name = "N", default_value_t = 3, allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=i64::MAX as u64))]
    pub seed: u64,
    /// How many samples, at most; evenly over the ticks.
    #[arg(long, value_name = "N", default_value_t = 1_000, allow_negative_numbers = true,
          value_parser = whole::<u64>(20..=2_000))]
    pub samples: u64,
    /// Override any key of the configuration, such as gate.mode=rules; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Folder of the samples and the plot.
    #[arg(long, value_name = "DIR", default_value = "soak")]
    pub out: PathBuf,
    /// Write the verdict to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Fewest ticks that say something after the warm-up.
const TICKS_MIN: u64 = verdict::WARM_UP_TICKS_MIN + 10_000;
/// Keys that a soak sets itself, and the option that says them.
const OWN_KEYS: [(&str, &str); 6] = [
    ("run.name", ""),
    ("run.folder", ""),
    ("run.clock", ""),
    ("run.seed", "--seed"),
    ("run.episodes", "--ticks"),
    ("run.duration_s", "--ticks"),
];
/// How long to wait between two looks at the tick.
const LOOK: Duration = Duration::from_millis(100);
/// The set has to say something within this time, ns.
const START_NS: u64 = 60_000_000_000;

/// What a soak found.
#[derive(Clone, Debug, Serialize)]
pub struct Soaked {
    /// All of it was flat.
    pub is_flat: bool,
    /// It was stopped before its end: the figures are of the ticks until then.
    pub was_stopped: bool,
    /// What was measured of each process, and of the run.
    pub rows: Vec<Flatness>,
    /// What flat means.
    pub rule: Rule,
    /// Ticks driven.
    pub ticks: u64,
    /// Ticks that the world skipped; 0 in lockstep.
    pub skipped: u64,
    /// Episodes driven.
    pub episodes: u64,
    /// Processes that died and were started again.
    pub restarts: u64,
    /// Seconds of the wall clock.
    pub wall_s: f64,
    /// Samples taken.
    pub samples: u64,
    /// Where.
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
/// When the set does not start or fails, when it is not flat or was stopped, or a file
/// cannot be written.
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
    let soaked = Soaked {
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
    figure::draw(&samples, &soaked, &arguments.out)?;
    verdict::print(&soaked);
    write_json_option(&arguments.json, &soaked)?;
    let word = if soaked.is_flat { "flat" } else { "not flat" };
    let path = arguments.out.join(SAMPLES);
    match (soaked.is_flat, soaked.was_stopped) {
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
    let config = settings::config(None, &arguments.overrides)?;
    // One more: the last tick shall be over when the time is.
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

/// Samples until the end, or until a stop is requested, written as they are taken: a
/// soak that is cut off leaves what it has seen.
fn watch(
    arguments: &BenchSoak,
    driven: &mut Driven,
    stop: &Stop,
    clock: Clock,
) -> anyhow::Result<Vec<Sample>> {
    let paths = RunPaths::new(driven.name().parse()?);
    let (_wire, mut progress) = listen(driven, &paths, clock)?;
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
            // Once: a second time would kill it.
            driven.stop();
            stopping = true;
        }
        if let Some(progress) = progress.newest(Message::check) {
            let tick = progress.header.tick;
            bar.set_position(tick);
            // None near the end: processes that leave hold less and less.
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

/// The world's word on how far it is; it comes when the world does.
fn listen(
    driven: &mut Driven,
    paths: &RunPaths,
    clock: Clock,
) -> anyhow::Result<(Wire, Subscriber<Progress>)> {
    let until = clock().after_ns(START_NS);
    while paths.supervisor_pid().is_none() {
        if driven.has_ended()? || clock() > until {
            bail!("the set does not start; its errors are above");
        }
        supervisor::machine::signals::pause(LOOK);
    }
    let wire = Wire::join(paths.name(), Process::Supervisor)?;
    let progress = wire.subscriber(PROGRESS)?;
    Ok((wire, progress))
}
