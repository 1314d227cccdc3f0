//! Compares the built-in world with recordings of MetaDrive: maps, spawns and first
//! observations; recorded actions are driven again, and recorded poses are evaluated by
//! our rules.
//!
//! Each row compares one aspect over all recorded seeds, with the limit beside it.

mod dynamics;
mod npz;
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

/// Ticks after which a replayed drive is compared, and the limits of the median position
/// error, m.
const LOOKS: [(usize, f64); 3] = [(10, 0.1), (30, 0.5), (50, 1.5)];

/// Unit of an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// Metres.
    M,
    /// A feature of the policy's input, in [0, 1].
    Feature,
    /// Number of differing items.
    Count,
}

/// One comparison.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The compared aspect.
    pub what: String,
    /// Number of compared items.
    pub compared: usize,
    /// Number of items that exceed the limit or cannot be compared.
    pub different: usize,
    /// The first seed with a differing item, where seeds are compared.
    pub first_seed: Option<u64>,
    /// The error; `figure` says which one.
    pub error: f64,
    /// Its unit.
    pub unit: Unit,
    /// Which error: `largest`, `median` or `p90`.
    pub figure: &'static str,
    /// Limit of the error; `None` if the row only informs.
    pub bar: Option<f64>,
    /// Whether the error is within the limit.
    pub met: Option<bool>,
}

impl Row {
    /// A row whose limit every item has to meet.
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
            // NaN, without any drive, is not within the limit.
            met: bar.map(|bar| error <= bar),
        }
    }
}

/// Counts of items compared one by one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    /// Number of compared items.
    pub compared: usize,
    /// Number of differing items.
    pub different: usize,
    /// The largest measurable error.
    pub largest: f64,
    /// The first seed with a differing item.
    pub first_seed: Option<u64>,
}

impl Tally {
    /// Counts an item by its error; `None` if the two items are of different kinds. NaN counts
    /// as different.
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

    /// Records `seed`, whose items have just been counted, if it is the first with a differing
    /// item.
    fn end_of(&mut self, seed: u64) {
        if self.different > 0 {
            self.first_seed.get_or_insert(seed);
        }
    }

    /// Counts items without a counterpart.
    fn missing(&mut self, count: usize) {
        self.compared += count;
        self.different += count;
    }
}

/// All comparisons with a set of recordings.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// The rows of the table.
    pub rows: Vec<Row>,
    /// The recordings that were used.
    pub conditions: Conditions,
}

/// The recordings that were used.
#[derive(Clone, Debug, Serialize)]
pub struct Conditions {
    /// Number of recorded seeds.
    pub seeds: usize,
    /// Number of recorded drives of all kinds.
    pub drives: usize,
    /// Whether drives are left out after their first contact.
    pub away_from_contacts: bool,
}

impl Comparison {
    /// Compares everything that is recorded in a folder.
    ///
    /// # Errors
    /// If a file is missing or invalid, or a recorded seed has no map here.
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

    /// Whether every row is within its limit.
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
    /// Also write the rows to this file.
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
/// If the recordings cannot be read.
fn bench(arguments: &Parity) -> anyhow::Result<ExitCode> {
    let comparison = Comparison::of(&arguments.data)?;
    let Conditions { seeds, drives, .. } = comparison.conditions;
    say(format_args!(
        "the built-in world against MetaDrive: {}, {}; replayed open loop, up to the first \
         contact",
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
