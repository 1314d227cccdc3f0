//! One row per fault, the file of rows, and their summary.

use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;

use anyhow::Context;
use clap::ValueEnum as _;
use serde::{Deserialize, Serialize};

use lab::report::table;
use lab::statistics::quantile;
use supervisor::subcommand::say;

use super::planned::Kind;

/// One fault and its outcome.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Row {
    /// The campaign's seed.
    pub seed: u64,
    /// The fault's number in it.
    pub number: u64,
    /// Tick rate, Hz.
    pub rate_hz: f64,
    /// The options that name foreign programs; empty without any.
    pub programs: String,
    /// Kind of the fault.
    pub kind: String,
    /// Target process; empty for the machine, or for all processes.
    pub target: String,
    /// Details of the fault.
    pub detail: String,
    /// Time of the fault, ns on the machine's monotonic clock.
    pub struck_ns: u64,
    /// From the fault to the next safe command or to the vehicle's own brake, ms.
    pub safe_ms: Option<f64>,
    /// What made the car safe: command, brake or vehicle.
    pub by: String,
    /// From the fault to the next safe command, ms.
    pub command_ms: Option<f64>,
    /// From the fault until the set drove on fresh inputs, ms.
    pub recovered_ms: Option<f64>,
    /// Commands beyond a limit since the previous fault.
    pub violations: u64,
    /// Steps since the previous fault.
    pub steps: u64,
    /// Of those, steps lost before they were read.
    pub lost: u64,
    /// Ticks that the controller skipped.
    pub skipped: u64,
    /// Ticks of the grid without a controller.
    pub unmanned: u64,
    /// Other ticks of the grid.
    pub unaccounted: u64,
    /// Number of things left behind.
    pub leftovers: u64,
    /// `ok`, `skipped`, or what was wrong.
    pub verdict: String,
}

impl Row {
    /// Whether the fault could not be injected on this machine.
    pub fn is_skipped(&self) -> bool {
        self.verdict == "skipped"
    }

    /// Whether the car was safe within this number of periods.
    pub fn is_safe_within(&self, periods: f64) -> bool {
        self.safe_ms
            .is_some_and(|safe_ms| safe_ms <= periods * 1e3 / self.rate_hz)
    }

    /// Whether the fault killed a process at once.
    pub fn is_death(&self) -> bool {
        Kind::from_str(&self.kind, false).is_ok_and(Kind::is_a_death)
    }
}

/// Reads the rows of a file; none if the file does not exist.
///
/// # Errors
/// If it cannot be read or is not such a file.
pub fn read(path: &Path) -> anyhow::Result<Vec<Row>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let named = || path.display().to_string();
    let mut reader = csv::Reader::from_path(path).with_context(named)?;
    let rows: Result<_, _> = reader.deserialize().collect();
    rows.with_context(named)
}

/// Appends a row to a file; a new file begins with the header.
///
/// # Errors
/// If it cannot be written. The file is then unchanged, so that `--resume` can read it.
pub fn append(path: &Path, row: &Row) -> anyhow::Result<()> {
    let named = || path.display().to_string();
    let mut options = OpenOptions::new();
    let file = options.append(true).create(true).open(path);
    let mut file = file.with_context(named)?;
    let before = file.metadata().with_context(named)?.len();
    let mut writer = csv::WriterBuilder::new()
        .has_headers(before == 0)
        .from_writer(Vec::new());
    writer.serialize(row)?;
    writer.flush()?;
    file.write_all(writer.get_ref()).with_context(|| {
        // A partly written line is no row. A file that is not regular keeps no data anyway.
        let _ = file.set_len(before);
        named()
    })
}

/// Summary of a group of rows.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// Kind and target, or the name of the group.
    pub what: String,
    /// Tick rate, Hz; 0 for all rates.
    pub rate_hz: f64,
    /// Number of faults.
    pub faults: usize,
    /// From the fault to safety, median, ms.
    pub safe_p50_ms: f64,
    /// The same, 99 % quantile, ms.
    pub safe_p99_ms: f64,
    /// The same, maximum, ms.
    pub safe_max_ms: f64,
    /// Number that were safe within two periods.
    pub within_two: usize,
    /// Number that the vehicle's own brake made safe.
    pub by_vehicle: usize,
    /// From the fault to the next safe command, median, ms.
    pub command_p50_ms: f64,
    /// The same, maximum, ms.
    pub command_max_ms: f64,
    /// From the fault to driving on fresh inputs, median, ms.
    pub recovered_p50_ms: f64,
    /// The same, maximum, ms.
    pub recovered_max_ms: f64,
}

/// Pass criteria of a campaign.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Criteria {
    /// Faults injected.
    pub faults: usize,
    /// Faults that this machine does not allow.
    pub skipped: usize,
    /// Commands beyond a limit; must be 0.
    pub violations: u64,
    /// Faults that killed a process at once.
    pub deaths: usize,
    /// Of those, safe within two periods; must be all.
    pub deaths_safe: usize,
    /// Things left behind; must be 0.
    pub leftovers: u64,
    /// Ticks unaccounted for; must be 0.
    pub unaccounted: u64,
    /// Steps read.
    pub steps: u64,
    /// Steps lost before they were read, by gaps in their numbers.
    pub lost: u64,
    /// Ticks that controllers skipped.
    pub skipped_ticks: u64,
    /// Ticks of the grid without a controller.
    pub unmanned: u64,
    /// Faults from which the set did not recover, or that ended otherwise than expected;
    /// must be 0.
    pub wrong: usize,
}

impl Criteria {
    /// Computes the criteria of all rows.
    pub fn of(rows: &[Row]) -> Self {
        let made: Vec<&Row> = rows.iter().filter(|row| !row.is_skipped()).collect();
        let sum = |of: fn(&Row) -> u64| rows.iter().map(of).sum();
        let deaths = made.iter().filter(|row| row.is_death());
        Self {
            faults: made.len(),
            skipped: rows.len() - made.len(),
            violations: sum(|row| row.violations),
            deaths: deaths.clone().count(),
            deaths_safe: deaths.filter(|row| row.is_safe_within(2.0)).count(),
            leftovers: sum(|row| row.leftovers),
            unaccounted: sum(|row| row.unaccounted),
            steps: sum(|row| row.steps),
            lost: sum(|row| row.lost),
            skipped_ticks: sum(|row| row.skipped),
            unmanned: sum(|row| row.unmanned),
            wrong: made.iter().filter(|row| row.verdict != "ok").count(),
        }
    }

    /// Whether at least one fault was injected and every criterion holds that does not
    /// depend on the speed of the machine.
    pub fn are_met(&self) -> bool {
        self.faults > 0
            && self.violations + self.leftovers + self.unaccounted == 0
            && self.wrong == 0
    }
}

/// Summaries by kind, target and rate, and of all deaths.
pub fn lines(rows: &[Row]) -> Vec<Summary> {
    let mut groups: BTreeMap<(String, u64), Vec<&Row>> = BTreeMap::new();
    for row in rows.iter().filter(|row| !row.is_skipped()) {
        let what = format!("{} {}", row.kind, row.target);
        let key = (what.trim().to_string(), row.rate_hz as u64);
        groups.entry(key).or_default().push(row);
    }
    let mut lines: Vec<Summary> = groups
        .into_iter()
        .map(|((what, rate_hz), rows)| line(what, rate_hz as f64, &rows))
        .collect();
    let deaths: Vec<&Row> = rows.iter().filter(|row| row.is_death()).collect();
    lines.push(line("all deaths".into(), 0.0, &deaths));
    lines
}

fn line(what: String, rate_hz: f64, rows: &[&Row]) -> Summary {
    let values = |of: fn(&Row) -> Option<f64>| -> Vec<f64> {
        rows.iter().filter_map(|row| of(row)).collect()
    };
    let safe = values(|row| row.safe_ms);
    let command = values(|row| row.command_ms);
    let recovered = values(|row| row.recovered_ms);
    Summary {
        what,
        rate_hz,
        faults: rows.len(),
        safe_p50_ms: quantile(&safe, 0.5),
        safe_p99_ms: quantile(&safe, 0.99),
        safe_max_ms: quantile(&safe, 1.0),
        within_two: rows.iter().filter(|row| row.is_safe_within(2.0)).count(),
        by_vehicle: rows.iter().filter(|row| row.by == "vehicle").count(),
        command_p50_ms: quantile(&command, 0.5),
        command_max_ms: quantile(&command, 1.0),
        recovered_p50_ms: quantile(&recovered, 0.5),
        recovered_max_ms: quantile(&recovered, 1.0),
    }
}

/// Prints the table.
pub fn print(lines: &[Summary]) {
    let mut table = table(&[
        "fault",
        "Hz",
        "faults",
        "safe p50 ms",
        "p99",
        "max",
        "in 2 periods",
        "own brake",
        "command p50 ms",
        "max",
        "drives p50 ms",
        "max",
    ]);
    for line in lines {
        let mut cells = vec![
            line.what.clone(),
            match line.rate_hz > 0.0 {
                true => line.rate_hz.to_string(),
                false => "all".into(),
            },
            line.faults.to_string(),
        ];
        let ms = |value: f64| match value.is_nan() {
            true => "-".into(),
            false => format!("{value:.1}"),
        };
        cells.extend([line.safe_p50_ms, line.safe_p99_ms, line.safe_max_ms].map(ms));
        cells.extend([line.within_two, line.by_vehicle].map(|count| count.to_string()));
        cells.extend([line.command_p50_ms, line.command_max_ms].map(ms));
        cells.extend([line.recovered_p50_ms, line.recovered_max_ms].map(ms));
        table.add_row(cells);
    }
    say(table);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(kind: &str, safe_ms: f64) -> Row {
        Row {
            rate_hz: 100.0,
            kind: kind.into(),
            safe_ms: Some(safe_ms),
            verdict: "ok".into(),
            ..Row::default()
        }
    }

    #[test]
    fn each_violated_criterion_fails_the_campaign() {
        let good = [row("kill", 19.0), row("slow", 30.0), row("panic", 21.0)];
        let bars = Criteria::of(&good);
        assert!(bars.are_met());
        assert_eq!((bars.deaths, bars.deaths_safe), (2, 1));
        assert!(!Criteria::of(&[]).are_met(), "nothing was tested");
        let spoils: [fn(&mut Row); 4] = [
            |row| row.violations = 1,
            |row| row.leftovers = 1,
            |row| row.unaccounted = 1,
            |row| row.verdict = "did not recover".into(),
        ];
        for spoil in spoils {
            let mut rows = good.clone();
            spoil(&mut rows[1]);
            assert!(!Criteria::of(&rows).are_met());
        }
    }

    #[test]
    fn rows_survive_their_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("faults.csv");
        for number in 0..3 {
            let mut written = row("kill", 1.5);
            written.number = number;
            written.target = "planner, or so".into();
            append(&path, &written).expect("written");
        }
        let rows = read(&path).expect("read");
        assert_eq!(rows.len(), 3);
        assert_eq!((rows[2].number, rows[2].safe_ms), (2, Some(1.5)));
        assert_eq!(rows[2].recovered_ms, None);
    }

    #[test]
    fn a_full_disk_is_reported_with_the_file() {
        let error = append(Path::new("/dev/full"), &row("kill", 1.5)).expect_err("it is full");
        let message = format!("{error:#}");
        assert!(
            message.starts_with("/dev/full: ") && message.contains("No space"),
            "{message}"
        );
    }
}
