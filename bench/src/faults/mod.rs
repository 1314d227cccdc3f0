//! `bench faults`: a campaign of faults on running sets. It checks that the car is
//! always safe, that the set recovers, and that nothing is left behind.

mod campaign;
pub mod foreign;
mod inject;
mod ledger;
mod malformed;
mod monitor;
mod picture;
mod planned;
mod programs;
mod results;
mod sandbox;
mod tested_set;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use supervisor::subcommand::{Output, Subcommand};

use anyhow::Context;
use clap::{Args, ValueEnum};
use serde::Serialize;
use shm_config::{Instant, counted};
use supervisor::cli::failure::Failure;
use supervisor::cli::parsers::whole;

use crate::floor::Priority;
use crate::stalls::{BUCKET_NS, StallWatch};
use campaign::Campaign;
use lab::report::Machine;
use lab::stop::Stop;
use planned::Kind;
use programs::Programs;
use results::{Criteria, Row, Summary};
use sandbox::Sandbox;
use stack::Clock;
use supervisor::subcommand::settings;
use supervisor::subcommand::{say, write_json_option};

/// Inject faults into a running set and measure how it recovers
#[derive(Debug, Args)]
#[command(
    after_help = "Sets drive at 100 Hz, one in eight at 10 Hz. The campaign watches them from outside, \
        as a vehicle does. The car is safe when the next command is within its limits and either \
        brakes or answers inputs within their age limits; or, if that comes first, when the vehicle \
        brakes by itself: it obeys no command older than one and a half periods. Disk and shared \
        memory are filled in a mount namespace of the campaign's own.\n\n\
        Exit code 1 when a command violates a limit, something is left behind, a tick is not \
        accounted for, a set does not recover, or no fault could be injected. After Ctrl-C, \
        --resume continues; the fault in progress is repeated.\n\n\
        Examples:\n  \
        ./vlaps bench faults --faults 30 --seed 1\n  \
        ./vlaps bench faults --faults 2000 --out campaign --json faults.json\n  \
        ./vlaps bench faults --faults 2000 --out campaign --resume\n  \
        ./vlaps bench faults --seed 1 --only 417\n  \
        ./vlaps bench faults --world ./my-robot --planner ./my-planner"
)]
pub struct BenchFaults {
    /// Number of faults.
    #[arg(long, value_name = "N", default_value_t = 200, allow_negative_numbers = true,
          value_parser = whole::<u64>(1..=1_000_000))]
    pub faults: u64,
    /// Seed that faults are drawn from.
    #[arg(long, value_name = "N", default_value_t = 1, allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// Kinds of faults; default: all.
    #[arg(long, value_name = "KIND", value_delimiter = ',')]
    pub kinds: Vec<Kind>,
    /// Repeat only the fault of this number.
    #[arg(long, value_name = "K")]
    pub only: Option<u64>,
    #[command(flatten)]
    programs: Programs,
    /// Tick rate of all sets, instead of 100 and 10.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// Set the wall clock of this machine forward by an hour and back, for all programs
    /// on it; without this option, such faults are skipped.
    #[arg(long)]
    pub step_clock: bool,
    /// Override a key of the configuration, such as planner.rate_hz=10; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Write a row for each fault, and the histogram, into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Continue the campaign in the folder.
    #[arg(long, requires = "out", conflicts_with = "fresh")]
    pub resume: bool,
    /// Delete the campaign in the folder and begin anew.
    #[arg(long, requires = "out")]
    pub fresh: bool,
    /// Also write the figures to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Keys that the campaign sets for each set, and the option that changes them.
const OWN_KEYS: [(&str, &str); 12] = [
    ("run.name", ""),
    ("run.folder", ""),
    ("run.clock", ""),
    ("run.seed", ""),
    ("run.episodes", ""),
    ("run.duration_s", ""),
    ("run.rate_hz", "--rate"),
    ("run.faults", ""),
    ("programs.world", "--world"),
    ("programs.planner", "--planner"),
    // The gate and the learner always run, so that they can be faulted, too.
    ("gate.mode", ""),
    ("learner.enabled", ""),
];

/// The results of a campaign.
#[derive(Debug, Serialize)]
struct Figures {
    rows: Vec<Summary>,
    bars: Criteria,
    /// Faults that this machine does not allow, with the reason.
    skipped: Vec<String>,
    /// Each fault that violated a criterion, with the command that repeats it.
    exceptions: Vec<String>,
    seed: u64,
    elapsed_s: f64,
    conditions: Machine,
}

/// A stall of the machine within this time of a fault is reported with it, ns: one
/// bucket of the stall record before and after.
const STALL_NEAR_NS: u64 = BUCKET_NS;

impl Subcommand for BenchFaults {
    fn outputs(&self) -> Vec<Output> {
        vec![
            Output::Folder("--out", self.out.clone()),
            Output::json(&self.json),
        ]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        bench(self, clock)
    }
}

/// `./vlaps bench faults`.
///
/// # Errors
/// If a set does not start, or a file cannot be written; the results until then are
/// printed all the same.
fn bench(arguments: &BenchFaults, clock: Clock) -> anyhow::Result<ExitCode> {
    settings::refuse_own(&arguments.overrides, &OWN_KEYS)?;
    let sandbox = Sandbox::enter()?;
    let stop = Stop::listen()?;
    let conditions = Machine::here()?;
    let mut campaign = Campaign::new(arguments, &sandbox, clock);
    campaign.check()?;
    let file = match &arguments.out {
        Some(folder) => Some(begin_file(folder, arguments)?),
        None => None,
    };
    let mut rows = match &file {
        Some(file) => results::read(file)?,
        None => Vec::new(),
    };
    campaign.check_same(&rows)?;
    let begun = clock();
    let noting = StallWatch::start(Priority::Asked, clock)?;
    let done = campaign.run(&mut rows, file.as_deref(), &stop);
    let stalls = noting.finish()?;
    let stall_ns = |row: &Row| {
        let injected = Instant(row.struck_ns);
        (injected >= begun).then(|| stalls.near(injected, STALL_NEAR_NS))
    };
    let figures = Figures {
        rows: results::lines(&rows),
        bars: Criteria::of(&rows),
        skipped: campaign.skipped(),
        exceptions: exceptions(&rows, arguments, stall_ns),
        seed: arguments.seed,
        elapsed_s: clock().since_ns(begun) as f64 * 1e-9,
        conditions,
    };
    if !rows.is_empty() {
        print(&figures);
    }
    done?;
    if let Some(folder) = &arguments.out {
        picture::draw(&rows, folder)?;
    }
    write_json_option(&arguments.json, &figures)?;
    match (campaign.left(&rows).len(), figures.bars.are_met()) {
        (0, true) => Ok(ExitCode::SUCCESS),
        (0, false) => Ok(ExitCode::FAILURE),
        (left, _) if arguments.out.is_some() => {
            anyhow::bail!("stopped, {left} faults are left; --resume continues")
        }
        (left, _) => anyhow::bail!("stopped, {left} faults are left; with --out rows are kept"),
    }
}

/// The requested kinds.
fn kinds(arguments: &BenchFaults) -> &[Kind] {
    match arguments.kinds.is_empty() {
        true => Kind::value_variants(),
        false => &arguments.kinds,
    }
}

fn begin_file(folder: &Path, arguments: &BenchFaults) -> anyhow::Result<PathBuf> {
    fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let file = folder.join("faults.csv");
    if arguments.fresh && file.exists() {
        fs::remove_file(&file).with_context(|| file.display().to_string())?;
    }
    if !arguments.resume && file.exists() {
        let message = format!(
            "--out {}: holds a campaign already; continue it with --resume, replace it with --fresh, or \
             give another folder",
            folder.display()
        );
        return Err(Failure::Usage(message).into());
    }
    Ok(file)
}

/// Every row that violates a criterion, and every death that took more than two periods.
fn exceptions(
    rows: &[Row],
    arguments: &BenchFaults,
    stall_ns: impl Fn(&Row) -> Option<u64>,
) -> Vec<String> {
    let mut options = vec![arguments.programs.line()];
    if !arguments.kinds.is_empty() {
        let kinds: Vec<&str> = arguments.kinds.iter().map(|kind| kind.word()).collect();
        options.push(format!("--kinds {}", kinds.join(",")));
    }
    let given = options.iter().filter(|option| !option.is_empty());
    let options: String = given.map(|option| format!(" {option}")).collect();
    let breaks = |row: &&Row| {
        let wrong = row.verdict != "ok" && !row.is_skipped();
        wrong
            || row.violations + row.leftovers + row.unaccounted > 0
            || (row.is_death() && !row.is_safe_within(2.0))
    };
    let message = |row: &Row| {
        let safe = row
            .safe_ms
            .map_or("never".into(), |ms| format!("after {ms:.1} ms"));
        // A virtual machine may stall for longer than two periods.
        let stall = stall_ns(row).map_or(String::new(), |ns| {
            format!(
                "the machine stalled for {:.1} ms beside it, ",
                ns as f64 / 1e6
            )
        });
        format!(
            "{} {} {}: safe {safe} by {}, {stall}{}, {}, {} unaccounted, {}; \
             repeat: ./vlaps bench faults --seed {}{options} --only {} --rate {}",
            row.kind,
            row.target,
            row.detail,
            row.by,
            counted(row.violations, "violation"),
            counted(row.leftovers, "leftover"),
            counted(row.unaccounted, "tick"),
            row.verdict,
            row.seed,
            row.number,
            row.rate_hz,
        )
    };
    rows.iter().filter(breaks).map(message).collect()
}

fn print(figures: &Figures) {
    results::print(&figures.rows);
    let bars = &figures.bars;
    for reason in &figures.skipped {
        say(format_args!("skipped: {reason}"));
    }
    for exception in &figures.exceptions {
        say(format_args!("exception: {exception}"));
    }
    say(format_args!(
        "{} in {:.0} s, {} skipped; {} beyond a limit; {} of {} safe within 2 periods; {}; {} that did not recover as expected",
        counted(bars.faults, "fault"),
        figures.elapsed_s,
        bars.skipped,
        counted(bars.violations, "command"),
        bars.deaths_safe,
        counted(bars.deaths, "death"),
        counted(bars.leftovers, "leftover"),
        counted(bars.wrong, "set")
    ));
    say(format_args!(
        "{} read, {} lost before they were read; ticks of the grid: {} skipped, {} without a \
         controller, {} unaccounted for; {}",
        counted(bars.steps, "step"),
        bars.lost,
        bars.skipped_ticks,
        bars.unmanned,
        bars.unaccounted,
        figures.conditions
    ));
}
