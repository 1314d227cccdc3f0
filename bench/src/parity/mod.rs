//! The built-in world against recordings of MetaDrive: maps, spawns, first
//! observations, and recorded actions driven again.
//!
//! Each row compares one thing over all recorded seeds, with its bar beside it.

pub mod record;
mod replay;
mod scenario;

use std::path::Path;
use std::process::ExitCode;

use comfy_table::Table;
use serde::Serialize;
use sim::{World, WorldConfig};

use crate::arguments::Parity;
use crate::report::{say, table, write_json};
use record::Golden;

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
        } = tally;
        Row {
            what: what.into(),
            compared,
            different,
            error: largest,
            unit,
            figure: "largest",
            bar: Some(bar),
            met: Some(compared > 0 && different == 0 && largest <= bar),
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
        for kind in record::rollout_kinds(folder)? {
            let (found, count) = replay::rows(folder, &kind, &mut world)?;
            rows.extend(found);
            drives += count;
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
            let differ = match row.bar {
                Some(_) => row.different.to_string(),
                None => String::new(),
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

/// `./vlaps bench parity`.
///
/// # Errors
/// When the record cannot be read.
pub fn bench(arguments: &Parity) -> anyhow::Result<ExitCode> {
    let comparison = Comparison::of(&arguments.data)?;
    let Conditions { seeds, drives, .. } = comparison.conditions;
    say(format_args!(
        "the built-in world against MetaDrive: {seeds} seeds, {drives} recorded drives; \
         replayed without any correction, up to the first contact"
    ));
    say(comparison.table());
    if let Some(path) = &arguments.json {
        write_json(path, &comparison)?;
    }
    Ok(match comparison.is_met() {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}
