//! `bench faults`: a campaign of faults on live sets. Is the car always safe, does
//! the set come back, is anything left?

mod campaign;
mod ledger;
mod lies;
mod picture;
mod room;
mod rows;
mod stage;
pub mod strangers;
mod strike;
mod trouble;
mod watch;

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
use crate::stalls::{MOMENT_NS, StallWatch};
use campaign::Campaign;
use lab::report::Machine;
use lab::stop::Stop;
use room::Room;
use rows::{Bars, Line, Row};
use stack::Clock;
use supervisor::subcommand::settings;
use supervisor::subcommand::{say, write_json_option};
use trouble::Kind;

/// Strike a running set with faults and measure how it takes them
#[derive(Debug, Args)]
#[command(
    after_help = "Sets drive at 100 Hz, one in eight at 10 Hz, and are watched from outside as a \
        vehicle would watch them. Safe is a command within its limits that is the brake or answers \
        inputs within their age limits; or, when that comes first, the vehicle's own brake: it obeys \
        no command older than one and a half periods. Disk and shared memory are filled in a mount \
        namespace of the campaign's own.\n\n\
        Exit code 1 when a command violates a limit, something is left behind, a tick is not \
        accounted for, a set does not come back, or no fault could be made. After Ctrl-C, \
        --resume continues; the fault in progress is made anew.\n\n\
        Examples:\n  \
        ./vlaps bench faults --faults 30 --seed 1\n  \
        ./vlaps bench faults --faults 2000 --out campaign --json faults.json\n  \
        ./vlaps bench faults --faults 2000 --out campaign --resume\n  \
        ./vlaps bench faults --seed 1 --only 417"
)]
pub struct BenchFaults {
    /// How many faults.
    #[arg(long, value_name = "N", default_value_t = 200, allow_negative_numbers = true,
          value_parser = whole::<u64>(1..=1_000_000))]
    pub faults: u64,
    /// Seed that faults are drawn from.
    #[arg(long, value_name = "N", default_value_t = 1, allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// Which kinds; without it, all.
    #[arg(long, value_name = "KIND", value_delimiter = ',')]
    pub kinds: Vec<Kind>,
    /// Repeat this fault alone, by its number.
    #[arg(long, value_name = "K")]
    pub only: Option<u64>,
    /// Ticks per second of all sets, in place of 100 and 10.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// Let the wall clock of this machine jump by an hour and back, for everybody
    /// on it; without this, such faults are skipped.
    #[arg(long)]
    pub step_clock: bool,
    /// Override a key of the configuration, such as planner.rate_hz=10; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Keep a row for each fault and the histogram in this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Go on with the campaign of the folder.
    #[arg(long, requires = "out", conflicts_with = "fresh")]
    pub resume: bool,
    /// Make the campaign of the folder anew.
    #[arg(long, requires = "out")]
    pub fresh: bool,
    /// Write the figures to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Keys that each set has from the campaign, and the option that says them.
const OWN_KEYS: [(&str, &str); 10] = [
    ("run.name", ""),
    ("run.folder", ""),
    ("run.clock", ""),
    ("run.seed", ""),
    ("run.episodes", ""),
    ("run.duration_s", ""),
    ("run.rate_hz", "--rate"),
    ("run.faults", ""),
    // Faults befall all processes there are.
    ("gate.mode", ""),
    ("learner.enabled", ""),
];

/// A campaign in figures.
#[derive(Debug, Serialize)]
struct Figures {
    rows: Vec<Line>,
    bars: Bars,
    /// Kinds that this machine does not allow, with the reason.
    skipped: Vec<String>,
    /// Each fault that broke a bar, with the command that repeats it.
    exceptions: Vec<String>,
    seed: u64,
    elapsed_s: f64,
    conditions: Machine,
}

/// How far from a fault a stall of the machine is reported beside it, ns: a moment of the
/// watch before and after.
const STALL_NEAR_NS: u64 = MOMENT_NS;

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
/// When a set does not start, or a file cannot be written; what was made until then is
/// printed all the same.
fn bench(arguments: &BenchFaults, clock: Clock) -> anyhow::Result<ExitCode> {
    settings::refuse_own(&arguments.overrides, &OWN_KEYS)?;
    let room = Room::enter()?;
    let stop = Stop::listen()?;
    let conditions = Machine::here()?;
    let mut campaign = Campaign::new(arguments, &room, clock);
    campaign.check()?;
    let file = match &arguments.out {
        Some(folder) => Some(begin_file(folder, arguments)?),
        None => None,
    };
    let mut rows = match &file {
        Some(file) => rows::read(file)?,
        None => Vec::new(),
    };
    campaign.check_same(&rows)?;
    let begun = clock();
    let noting = StallWatch::start(Priority::Asked, clock)?;
    let done = campaign.run(&mut rows, file.as_deref(), &stop);
    let stalls = noting.finish()?;
    let stall_ns = |row: &Row| {
        let struck = Instant(row.struck_ns);
        (struck >= begun).then(|| stalls.near(struck, STALL_NEAR_NS))
    };
    let figures = Figures {
        rows: rows::lines(&rows),
        bars: Bars::of(&rows),
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
    match (campaign.left(&rows).len(), figures.bars.hold()) {
        (0, true) => Ok(ExitCode::SUCCESS),
        (0, false) => Ok(ExitCode::FAILURE),
        (left, _) if arguments.out.is_some() => {
            anyhow::bail!("stopped, {left} faults are left; --resume continues")
        }
        (left, _) => anyhow::bail!("stopped, {left} faults are left; with --out rows are kept"),
    }
}

/// The kinds wished for.
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
        let told = format!(
            "--out {}: holds a campaign; go on with it with --resume, make it anew with --fresh, or \
             give another folder",
            folder.display()
        );
        return Err(Failure::Usage(told).into());
    }
    Ok(file)
}

/// Every row that breaks a bar, and every death that took more than two periods.
fn exceptions(
    rows: &[Row],
    arguments: &BenchFaults,
    stall_ns: impl Fn(&Row) -> Option<u64>,
) -> Vec<String> {
    let kinds: Vec<&str> = arguments.kinds.iter().map(|kind| kind.word()).collect();
    let kinds = match kinds.is_empty() {
        true => String::new(),
        false => format!(" --kinds {}", kinds.join(",")),
    };
    let breaks = |row: &&Row| {
        let wrong = row.verdict != "ok" && !row.is_skipped();
        wrong
            || row.violations + row.leftovers + row.unaccounted > 0
            || (row.is_death() && !row.is_safe_within(2.0))
    };
    let told = |row: &Row| {
        let safe = row
            .safe_ms
            .map_or("never".into(), |ms| format!("after {ms:.1} ms"));
        // A virtual machine may be away for longer than two periods.
        let stall = stall_ns(row).map_or(String::new(), |ns| {
            format!(
                "the machine stalled for {:.1} ms beside it, ",
                ns as f64 / 1e6
            )
        });
        format!(
            "{} {} {}: safe {safe} by {}, {stall}{}, {}, {} unaccounted, {}; \
             repeat: ./vlaps bench faults --seed {}{kinds} --only {} --rate {}",
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
    rows.iter().filter(breaks).map(told).collect()
}

fn print(figures: &Figures) {
    rows::print(&figures.rows);
    let bars = &figures.bars;
    for reason in &figures.skipped {
        say(format_args!("skipped: {reason}"));
    }
    for exception in &figures.exceptions {
        say(format_args!("exception: {exception}"));
    }
    say(format_args!(
        "{} in {:.0} s, {} skipped; {} beyond a limit; {} of {} safe within 2 periods; {}; {} that did not come back as they should",
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
        "{} read, {} lost before they were read; of the grid's ticks {} skipped, {} without a \
         controller, {} unaccounted for; {}",
        counted(bars.steps, "step"),
        bars.lost,
        bars.skipped_ticks,
        bars.unmanned,
        bars.unaccounted,
        figures.conditions
    ));
}
