//! The built-in world against recordings of MetaDrive: maps, spawns, first
//! observations, recorded actions driven again, recorded poses judged again.
//!
//! Each row compares one thing over all recorded seeds, with its bar beside it.

mod dynamics;
pub mod record;
mod replay;
mod rules;
mod scenario;

use std::path::PathBuf;

use clap::Args;
use stack::Clock;
use std::path::Path;
use std::process::ExitCode;

use comfy_table::Table;
use serde::Serialize;
use shm_config::counted;
use sim::model::Forces;
use sim::{World, WorldConfig};

use crate::report::table;
use crate::statistics::quantile;
use record::{Golden, Rollout};
use supervisor::subcommand::{Output, Subcommand, say, write_json_option};

/// After how many ticks to look at a drive, and how far from the record the
/// median one may be by then, m.
const LOOKS: [(usize, f64); 3] = [(10, 0.1), (30, 0.5), (50, 1.5)];

/// What a row measures, and in what.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// Metres.
    M,
    /// A feature of the policy's input, which lies in [0, 1].
    Feature,
    /// Things that differ.
    Count,
}

/// One comparison.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// What is compared.
    pub what: String,
    /// How many of them.
    pub compared: usize,
    /// How many of them differ by more than the bar, or cannot be compared.
    pub different: usize,
    /// The first seed of which one differs, where seeds are compared.
    pub first_seed: Option<u64>,
    /// The largest or typical error, as `figure` says.
    pub error: f64,
    /// Its unit.
    pub unit: Unit,
    /// Which error it is: `largest`, `median`, `p90`.
    pub figure: &'static str,
    /// The error may not exceed this; without one, the row only informs.
    pub bar: Option<f64>,
    /// Whether the bar is met.
    pub met: Option<bool>,
}

impl Row {
    /// A row whose bar every single item has to meet.
    fn largest(what: &str, tally: Tally, unit: Unit, bar: f64) -> Row {
        let Tally {
            compared,
            different,
            largest,
            first_seed,
        } = tally;
        Row {
            what: what.into(),
            compared,
            different,
            first_seed,
            error: largest,
            unit,
            figure: "largest",
            bar: Some(bar),
            met: Some(compared > 0 && different == 0 && largest <= bar),
        }
    }

    /// A row of a quantile of many errors.
    fn typical(
        what: &str,
        errors: &mut [f64],
        (unit, share): (Unit, f64),
        bar: Option<f64>,
    ) -> Row {
        let error = quantile(errors, share);
        let over = |bar: f64| errors.iter().filter(|error| **error > bar).count();
        Row {
            what: what.into(),
            compared: errors.len(),
            different: bar.map_or(0, over),
            first_seed: None,
            error,
            unit,
            figure: if share == 0.5 { "median" } else { "p90" },
            bar,
            // NaN, of no drives at all, meets nothing.
            met: bar.map(|bar| error <= bar),
        }
    }
}

/// Items compared one by one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    /// How many.
    pub compared: usize,
    /// How many differ.
    pub different: usize,
    /// The largest error among those that could be measured.
    pub largest: f64,
    /// The first seed of which one differs.
    pub first_seed: Option<u64>,
}

impl Tally {
    /// Counts an item: its error, or `None` when the two are not the same kind
    /// of thing at all. NaN counts as different.
    fn count(&mut self, error: Option<f64>, bar: f64) {
        self.compared += 1;
        match error {
            Some(error) if error <= bar => self.largest = self.largest.max(error),
            Some(error) => {
                self.different += 1;
                self.largest = self.largest.max(error);
            }
            None => self.different += 1,
        }
    }

    /// Remembers a seed whose items have been counted if it is the first of
    /// which one differs.
    fn end_of(&mut self, seed: u64) {
        if self.different > 0 {
            self.first_seed.get_or_insert(seed);
        }
    }

    /// Counts items that have no counterpart.
    fn missing(&mut self, count: usize) {
        self.compared += count;
        self.different += count;
    }
}

/// All comparisons of a record.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// The table's rows.
    pub rows: Vec<Row>,
    /// What was compared with what.
    pub conditions: Conditions,
}

/// What was compared with what.
#[derive(Clone, Debug, Serialize)]
pub struct Conditions {
    /// Recorded seeds.
    pub seeds: usize,
    /// Recorded drives, all kinds together.
    pub drives: usize,
    /// Drives that had touched something before a row's instant are not in it.
    pub away_from_contacts: bool,
}

impl Comparison {
    /// Compares everything that is recorded in a folder.
    ///
    /// # Errors
    /// When a file is missing or not what it should be, or a recorded seed has
    /// no map here.
    pub fn of(folder: &Path) -> anyhow::Result<Comparison> {
        let golden = Golden::read(folder)?;
        let mut rows = scenario::rows(&golden)?;
        let mut world = World::new(WorldConfig::default())?;
        let mut drives = 0;
        rows.extend(dynamics::response_rows(folder)?);
        let forces = |seed: u64| {
            let ego = &golden.seeds.get(&seed)?.ego;
            Some(Forces {
                engine_n: ego.engine,
                brake: ego.brake,
            })
        };
        for kind in record::rollout_kinds(folder)? {
            let rollouts = Rollout::read_all(folder, &kind)?;
            rows.extend(rules::rows(&kind, &rollouts, &mut world)?);
            rows.extend(replay::rows(&kind, &rollouts, &mut world)?);
            rows.extend(dynamics::window_rows(&kind, &rollouts, forces)?);
            drives += rollouts.len();
        }
        Ok(Comparison {
            rows,
            conditions: Conditions {
                seeds: golden.seeds.len(),
                drives,
                away_from_contacts: true,
            },
        })
    }

    /// Whether no bar is missed.
    pub fn is_met(&self) -> bool {
        self.rows.iter().all(|row| row.met != Some(false))
    }

    /// The rows as a table.
    pub fn table(&self) -> Table {
        let mut table = table(&["", "compared", "differ", "error", "", "bar", ""]);
        for row in &self.rows {
            let differ = match (row.bar, row.first_seed) {
                (Some(_), Some(seed)) => format!("{}, first at seed {seed}", row.different),
                (Some(_), None) => row.different.to_string(),
                (None, _) => String::new(),
            };
            table.add_row([
                row.what.clone(),
                row.compared.to_string(),
                differ,
                in_unit(row.error, row.unit),
                row.figure.to_string(),
                row.bar.map_or(String::new(), |bar| in_unit(bar, row.unit)),
                match row.met {
                    Some(true) => "met".into(),
                    Some(false) => "MISSED".into(),
                    None => String::new(),
                },
            ]);
        }
        table
    }
}

fn in_unit(value: f64, unit: Unit) -> String {
    let number = match value {
        value if value != 0.0 && value < 1e-3 => format!("{value:.1e}"),
        value => format!("{value:.3}"),
    };
    match unit {
        Unit::M => format!("{number} m"),
        Unit::Feature => number,
        Unit::Count => format!("{value:.0}"),
    }
}

/// Compare the built-in world with recordings of MetaDrive.
#[derive(Debug, Args)]
#[command(after_help = "Exit code 1 when a bar is missed.\n\n\
        Example:\n  ./vlaps bench parity --data recordings --json parity.json")]
pub struct Parity {
    /// Folder with golden_*.json.gz, rollouts/KIND/seedN.npz and dynamics.json.
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Write the rows to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Subcommand for Parity {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, _clock: Clock) -> anyhow::Result<ExitCode> {
        bench(self)
    }
}

/// `./vlaps bench parity`.
///
/// # Errors
/// When the record cannot be read.
fn bench(arguments: &Parity) -> anyhow::Result<ExitCode> {
    let comparison = Comparison::of(&arguments.data)?;
    let Conditions { seeds, drives, .. } = comparison.conditions;
    say(format_args!(
        "the built-in world against MetaDrive: {}, {}; replayed without any \
         correction, up to the first contact",
        counted(seeds, "seed"),
        counted(drives, "recorded drive")
    ));
    say(comparison.table());
    write_json_option(&arguments.json, &comparison)?;
    Ok(match comparison.is_met() {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}
