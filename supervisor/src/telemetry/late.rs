//! The ticks of a run that were most late, with the part that took longest in each.

use std::fmt::Write as _;

use serde::Serialize;
use shm_config::message::{LATE_TICKS, Part};
use shm_config::services::Process;

use crate::telemetry::tally::Tally;

/// A late tick.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LateRow {
    /// The process.
    pub process: &'static str,
    /// The tick of the run.
    pub tick: u64,
    /// The part of it that took longest.
    pub part: &'static str,
    /// The duration of that part, us.
    pub part_us: f64,
    /// From its deadline to its completion, us; for a tick after skipped ones, from the
    /// deadline of the first skipped one.
    pub late_us: f64,
    /// Ticks skipped immediately before it.
    pub skipped: u64,
}

/// The most late ticks of all processes over all restarts, the most late first; at most
/// [`LATE_TICKS`].
pub fn most_late(tally: &Tally) -> Vec<LateRow> {
    let mut rows = Vec::new();
    for process in Process::ALL {
        let Some(counted) = tally.process(*process) else {
            continue;
        };
        rows.extend(counted.timing().late_ticks().iter().map(|late| LateRow {
            process: process.word(),
            tick: late.tick,
            part: Part::from_code(late.part).map_or("unknown", Part::word),
            part_us: late.part_ns as f64 / 1e3,
            late_us: late.late_ns as f64 / 1e3,
            skipped: late.skipped,
        }));
    }
    rows.sort_by(|a, b| b.late_us.total_cmp(&a.late_us));
    rows.truncate(LATE_TICKS);
    rows
}

/// The ticks as a table, or a line that says that there are none.
pub fn table(rows: &[LateRow]) -> String {
    if rows.is_empty() {
        return "no tick was late".into();
    }
    let mut text = String::from("most late ticks  tick      late, ms   skipped  longest part, ms");
    for row in rows {
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\n  {:<11}{:>8}{:>14.3}{:>10}  {} {:.3}",
            row.process,
            row.tick,
            row.late_us / 1e3,
            row.skipped,
            row.part,
            row.part_us / 1e3
        );
    }
    text
}
