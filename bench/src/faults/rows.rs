//! A row for each fault, a file of rows, and what they come to.

use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;

use anyhow::Context;
use serde::{Deserialize, Serialize};

use lab::report::table;
use lab::statistics::quantile;
use supervisor::subcommand::say;

/// One fault and what came of it.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Row {
    /// The campaign's seed.
    pub seed: u64,
    /// The fault's number in it.
    pub number: u64,
    /// Ticks a second.
    pub rate_hz: f64,
    /// What went wrong.
    pub kind: String,
    /// With whom; empty for the machine, or for all.
    pub target: String,
    /// More about it.
    pub detail: String,
    /// When, ns on the machine's clock.
    pub struck_ns: u64,
    /// From the fault to the next safe command or the vehicle's own brake, ms.
    pub safe_ms: Option<f64>,
    /// Which of both: command, brake or vehicle.
    pub by: String,
    /// From the fault to the next safe command, ms.
    pub command_ms: Option<f64>,
    /// From the fault until the set drove on fresh inputs, ms.
    pub recovered_ms: Option<f64>,
    /// Commands beyond a limit since the fault before.
    pub violations: u64,
    /// Steps since the fault before.
    pub steps: u64,
    /// Of those, lost before they were read.
    pub lost: u64,
    /// Ticks that the controller skipped.
    pub skipped: u64,
    /// Ticks of the grid while no controller lived.
    pub unmanned: u64,
    /// Ticks of the grid that are none of these.
    pub unaccounted: u64,
    /// Things left behind.
    pub leftovers: u64,
    /// `ok`, `skipped`, or what was wrong.
    pub verdict: String,
}

impl Row {
    /// It was no fault on this machine.
    pub fn is_skipped(&self) -> bool {
        self.verdict == "skipped"
    }

    /// The car was safe within so many periods.
    pub fn is_safe_within(&self, periods: f64) -> bool {
        self.safe_ms
            .is_some_and(|safe_ms| safe_ms <= periods * 1e3 / self.rate_hz)
    }

    /// A process died at once.
    pub fn is_death(&self) -> bool {
        ["kill", "panic", "allocation", "all"].contains(&self.kind.as_str())
    }
}

/// Reads the rows of a file; none when there is none.
///
/// # Errors
/// When it cannot be read or is no such file.
pub fn read(path: &Path) -> anyhow::Result<Vec<Row>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let named = || path.display().to_string();
    let mut reader = csv::Reader::from_path(path).with_context(named)?;
    let rows: Result<_, _> = reader.deserialize().collect();
    rows.with_context(named)
}

/// Adds a row to a file, which is begun with its header.
///
/// # Errors
/// When it cannot be written. The file is then as it was: `--resume` reads it.
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
        // A part of a line would be no row; of what is no plain file none stays.
        let _ = file.set_len(before);
        named()
    })
}

/// A share of the rows in figures.
#[derive(Debug, Clone, Serialize)]
pub struct Line {
    /// Kind and target, or a sum.
    pub what: String,
    /// Ticks a second; 0 for all.
    pub rate_hz: f64,
    /// Faults.
    pub faults: usize,
    /// From the fault to safety, median, ms.
    pub safe_p50_ms: f64,
    /// ... 99 %.
    pub safe_p99_ms: f64,
    /// ... the longest.
    pub safe_max_ms: f64,
    /// Safe within two periods.
    pub within_two: usize,
    /// Made safe by the vehicle's own brake.
    pub by_vehicle: usize,
    /// From the fault to the next safe command, median, ms.
    pub command_p50_ms: f64,
    /// ... the longest.
    pub command_max_ms: f64,
    /// From the fault to driving on fresh inputs, median, ms.
    pub recovered_p50_ms: f64,
    /// ... the longest.
    pub recovered_max_ms: f64,
}

/// The bars of a campaign.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Bars {
    /// Faults made.
    pub faults: usize,
    /// Faults that this machine does not allow.
    pub skipped: usize,
    /// Commands beyond a limit; must be 0.
    pub violations: u64,
    /// Processes that died at once.
    pub deaths: usize,
    /// Of those, safe within two periods; must be all.
    pub deaths_safe: usize,
    /// Things left behind; must be 0.
    pub leftovers: u64,
    /// Ticks that no figure accounts for; must be 0.
    pub unaccounted: u64,
    /// Steps read.
    pub steps: u64,
    /// Steps lost before they were read, by their numbers.
    pub lost: u64,
    /// Ticks that controllers skipped.
    pub skipped_ticks: u64,
    /// Ticks of the grid while no controller lived.
    pub unmanned: u64,
    /// Faults that the set did not come back from, or that ended otherwise than
    /// they should; must be 0.
    pub wrong: usize,
}

impl Bars {
    /// Of all rows.
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

    /// Everything that does not depend on how fast the machine is holds, of a fault at
    /// least.
    pub fn hold(&self) -> bool {
        self.faults > 0
            && self.violations + self.leftovers + self.unaccounted == 0
            && self.wrong == 0
    }
}

/// The figures by kind, target and rate, and of all deaths.
pub fn lines(rows: &[Row]) -> Vec<Line> {
    let mut groups: BTreeMap<(String, u64), Vec<&Row>> = BTreeMap::new();
    for row in rows.iter().filter(|row| !row.is_skipped()) {
        let what = format!("{} {}", row.kind, row.target);
        let key = (what.trim().to_string(), row.rate_hz as u64);
        groups.entry(key).or_default().push(row);
    }
    let mut lines: Vec<Line> = groups
        .into_iter()
        .map(|((what, rate_hz), rows)| line(what, rate_hz as f64, &rows))
        .collect();
    let deaths: Vec<&Row> = rows.iter().filter(|row| row.is_death()).collect();
    lines.push(line("all deaths".into(), 0.0, &deaths));
    lines
}

fn line(what: String, rate_hz: f64, rows: &[&Row]) -> Line {
    let values = |of: fn(&Row) -> Option<f64>| -> Vec<f64> {
        rows.iter().filter_map(|row| of(row)).collect()
    };
    let safe = values(|row| row.safe_ms);
    let command = values(|row| row.command_ms);
    let recovered = values(|row| row.recovered_ms);
    Line {
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
pub fn print(lines: &[Line]) {
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
    fn bars_break_at_the_first_thing_that_is_wrong() {
        let good = [row("kill", 19.0), row("slow", 30.0), row("panic", 21.0)];
        let bars = Bars::of(&good);
        assert!(bars.hold());
        assert_eq!((bars.deaths, bars.deaths_safe), (2, 1));
        assert!(!Bars::of(&[]).hold(), "nothing was tested");
        let spoils: [fn(&mut Row); 4] = [
            |row| row.violations = 1,
            |row| row.leftovers = 1,
            |row| row.unaccounted = 1,
            |row| row.verdict = "did not come back".into(),
        ];
        for spoil in spoils {
            let mut rows = good.clone();
            spoil(&mut rows[1]);
            assert!(!Bars::of(&rows).hold());
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
    fn a_full_disk_is_told_with_the_file() {
        let error = append(Path::new("/dev/full"), &row("kill", 1.5)).expect_err("it is full");
        let told = format!("{error:#}");
        assert!(
            told.starts_with("/dev/full: ") && told.contains("No space"),
            "{told}"
        );
    }
}
