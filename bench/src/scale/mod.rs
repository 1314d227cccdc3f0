//! `bench scale`: how each cost grows with its work.
//!
//! | module | work | cost |
//! |---|---|---|
//! | [`beams`] | beams of the scanner | an observation |
//! | [`bodies`] | cars and obstacles in the world | a tick of the world |
//! | [`plans`] | iterations of RRT* | a plan |
//! | [`worlds`] | worlds of a batch | a step of the batch; memory |
//! | [`episodes`] | episodes of an evaluation | the evaluation |
//! | [`recording`] | ticks of a recorded run | bytes of the file; time to write it |
//! | [`sets`] | sets beside each other on this machine | response of their controllers, late ticks |
//!
//! | module | shared by them |
//! |---|---|
//! | [`sweep`] | a cost over its work, measured in turns |
//! | [`rows`] | finished rows, so that a stopped measurement continues |
//! | [`fit`] | the exponent of a cost |
//! | [`picture`] | one log-log picture of all costs |
//! | [`fleet`] | ten thousand actors and a thousand cars, from measured costs |

pub mod beams;
pub mod bodies;
pub mod episodes;
pub mod fit;
pub mod fleet;
pub mod picture;
pub mod plans;
pub mod recording;
pub mod rows;
pub mod sets;
pub mod sweep;
pub mod worlds;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, ValueEnum};
use lab::progress::Progress;
use lab::report::{Machine, table};
use lab::stop::Stop;
use serde::Serialize;
use stack::Clock;
use supervisor::cli::failure::Failure;
use supervisor::subcommand::{Output, Subcommand, say, seconds, write_json, write_json_option};

use crate::gauges::Gauges;
use fit::Fit;
use rows::{Row, RowStore, Settings};
use sweep::{Bench, Sweep};

/// Measure how each cost grows with its work, or model a fleet from measured costs.
#[derive(Debug, Args)]
#[command(
    after_help = "Each sweep doubles its work and measures the cost, most of them as processor time of \
        one thread, so that other programs on the machine disturb them little. The exponent is \
        that of the power law through the points; 1 is linear. sets-10 and sets-100 start more and \
        more whole process sets at 10 and 100 Hz, until one of them is late where an idle thread \
        of the same priority is not.\n\n\
        With --out each row is kept as soon as it is done: after Ctrl-C, the same command \
        continues; other settings are refused; --fresh measures all rows again.\n\n\
        --fleet measures nothing: it simulates 10,000 actors with one learner and 1,000 cars with \
        one server from the costs of results/, and prints the first part that breaks.\n\n\
        Examples:\n  \
        ./vlaps bench scale --out scale\n  \
        ./vlaps bench scale --sweep beams,plans --seconds 2 --json scale.json\n  \
        ./vlaps bench scale --fleet\n  \
        ./vlaps bench scale --fleet --actors 100 --cars 10"
)]
pub struct BenchScale {
    /// Costs to measure; default: all.
    #[arg(long, value_name = "WHAT", value_delimiter = ',')]
    pub sweep: Vec<Sweep>,
    /// Seconds for each row; those of sets are as long as given.
    #[arg(long, value_name = "S", default_value = "2", value_parser = seconds)]
    pub seconds: f64,
    /// Most sets beside each other.
    #[arg(long, value_name = "N", default_value_t = 32, allow_negative_numbers = true,
          value_parser = supervisor::cli::parsers::whole::<u64>(1..=1000))]
    pub sets_max: u64,
    /// Write rows and the picture (SVG, PNG) into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Measure rows again that --out holds already.
    #[arg(long, requires = "out")]
    pub fresh: bool,
    /// Do not measure: simulate a fleet from measured costs.
    #[arg(long, conflicts_with_all = ["sweep", "seconds", "sets_max", "out", "fresh"])]
    pub fleet: bool,
    /// Actors of the fleet, each with a batch of worlds.
    #[arg(long, value_name = "N", default_value_t = 10_000, requires = "fleet",
          allow_negative_numbers = true,
          value_parser = supervisor::cli::parsers::whole::<u64>(1..=1_000_000))]
    pub actors: u64,
    /// Cars of the fleet.
    #[arg(long, value_name = "N", default_value_t = 1000, requires = "fleet",
          allow_negative_numbers = true,
          value_parser = supervisor::cli::parsers::whole::<u64>(1..=1_000_000))]
    pub cars: u64,
    /// Also write the figures to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// The rows of one sweep.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// Name as in `--sweep`.
    pub sweep: &'static str,
    /// What grows.
    pub work: &'static str,
    /// What it costs, with the unit.
    pub cost: &'static str,
    /// The power law through the medians; `None` with fewer than three rows.
    pub fit: Option<Fit>,
    /// The rows, by growing work.
    pub rows: Vec<Row>,
}

/// All sweeps.
#[derive(Clone, Debug, Serialize)]
pub struct ScaleResults {
    /// In the requested order.
    pub sweeps: Vec<Measured>,
    /// Seconds for each row.
    pub seconds: f64,
    /// Number of requested sweeps that a stop request ended early.
    pub left: usize,
    /// The machine.
    pub conditions: Machine,
}

impl Subcommand for BenchScale {
    fn outputs(&self) -> Vec<Output> {
        vec![
            Output::Folder("--out", self.out.clone()),
            Output::json(&self.json),
        ]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        if self.fleet {
            return fleet::run(self);
        }
        let bench = Bench {
            gauges: Gauges::new(clock),
            seconds: self.seconds,
            sets_max: self.sets_max,
            stop: Stop::listen()?,
            scratch: tempfile::tempdir()?,
        };
        let conditions = Machine::here()?;
        let store = RowStore::open(self.out.as_deref())?;
        let asked = match self.sweep.is_empty() {
            true => Sweep::value_variants().to_vec(),
            false => self.sweep.clone(),
        };
        let mut sweeps = Vec::new();
        let mut left = 0;
        for sweep in asked {
            if self.fresh {
                store.forget(sweep);
            }
            let (measured, is_whole) = measure(sweep, &bench, &store)?;
            left += usize::from(!is_whole);
            if !measured.rows.is_empty() {
                sweeps.push(measured);
            }
        }
        let results = ScaleResults {
            sweeps,
            seconds: self.seconds,
            left,
            conditions,
        };
        print(&results);
        if let Some(out) = self.out.as_deref().filter(|_| !results.sweeps.is_empty()) {
            picture::draw(&results, out)?;
            write_json(&out.join("scale.json"), &results)?;
            say(format_args!("rows and picture: {}", out.display()));
        }
        write_json_option(&self.json, &results)?;
        match (results.left, self.out.is_some()) {
            (0, _) => Ok(ExitCode::SUCCESS),
            (_, true) => Err(stopped("the same command continues, without --fresh")),
            (_, false) => Err(stopped("with --out rows are kept")),
        }
    }
}

fn stopped(next: &str) -> anyhow::Error {
    Failure::GivenUp(format!("stopped, rows are left; {next}")).into()
}

/// Adds a row for each amount of work, kept or measured; whether all are there.
fn measure(sweep: Sweep, bench: &Bench, store: &RowStore) -> anyhow::Result<(Measured, bool)> {
    let settings = Settings::of(bench.seconds);
    let values = sweep.values(bench);
    let total = values.len() as u64;
    let name = format!("scale, {}", sweep.word());
    let mut progress = Progress::begin(name, "rows", (0, total), bench.gauges.clock())?;
    let mut rows: Vec<Row> = Vec::new();
    let mut is_whole = true;
    for value in values {
        if rows.last().is_some_and(Row::ends_sweep) {
            break;
        }
        let row = match store.kept(sweep, value, &settings)? {
            Some(row) => row,
            None if bench.stop.is_asked() => {
                is_whole = false;
                break;
            }
            None => {
                progress.now(&format!("{value} {}", sweep.work()));
                let Some(cost) = sweep.measure(value, bench)? else {
                    is_whole = false;
                    break;
                };
                let row = Row::new(value, &cost, &settings);
                store.keep(sweep, &row)?;
                row
            }
        };
        rows.push(row);
        progress.at(rows.len() as u64);
    }
    progress.end();
    let points: Vec<(f64, f64)> = rows.iter().map(|row| (row.work, row.median)).collect();
    let measured = Measured {
        sweep: sweep.word(),
        work: sweep.work(),
        cost: sweep.cost(),
        fit: Fit::of(&points),
        rows,
    };
    Ok((measured, is_whole))
}

fn print(results: &ScaleResults) {
    for measured in &results.sweeps {
        let is_sets = measured.rows.iter().any(|row| row.late.is_some());
        let mut header = vec![measured.work, measured.cost, "quartiles", "per unit"];
        if is_sets {
            header.extend(["late ticks", "of the floor"]);
        }
        let mut rows = table(&header);
        for row in &measured.rows {
            let mut cells = vec![
                figure(row.work),
                figure(row.median),
                format!(
                    "{} to {}",
                    figure(row.quartiles[0]),
                    figure(row.quartiles[1])
                ),
                figure(row.median / row.work),
            ];
            if let Some(late) = row.late {
                cells.extend([late.sets.to_string(), late.floor.to_string()]);
            }
            rows.add_row(cells);
        }
        say(format_args!("{}:", measured.sweep));
        say(rows);
        if let Some(fit) = &measured.fit {
            say(fit);
        }
        if is_sets {
            say(sets::verdict(&measured.rows));
        }
    }
    say(format_args!(
        "{} s a row; {}",
        results.seconds, results.conditions
    ));
}

/// A number with three digits.
pub fn figure(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        large if large >= 99.95 => format!("{value:.0}"),
        middle if middle >= 9.995 => format!("{value:.1}"),
        small if small >= 0.0995 => format!("{value:.2}"),
        _ => format!("{value:.2e}"),
    }
}
