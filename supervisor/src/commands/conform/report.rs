//! The report: which promises a world keeps.

use std::fmt;

use serde::Serialize;

/// One promise.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Row {
    /// What a world promises.
    pub(super) promise: &'static str,
    /// Whether it was kept; `None` when it could not be tested, since an earlier one was
    /// not.
    pub(super) held: Option<bool>,
    /// What was measured.
    pub(super) figure: String,
}

/// The rows of one test.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct Report {
    /// The program, or the name of the world.
    pub(super) world: String,
    /// The run's rate, Hz.
    pub(super) rate_hz: f64,
    /// The promises, in the order in which they were tested.
    pub(super) rows: Vec<Row>,
}

impl Report {
    /// Adds a row.
    pub(super) fn add(&mut self, promise: &'static str, held: bool, figure: impl fmt::Display) {
        self.rows.push(Row {
            promise,
            held: Some(held),
            figure: figure.to_string(),
        });
    }

    /// Adds a promise that could not be tested.
    pub(super) fn skip(&mut self, promise: &'static str, why: &str) {
        self.rows.push(Row {
            promise,
            held: None,
            figure: why.into(),
        });
    }

    /// Promises that are not known to hold.
    pub(super) fn broken(&self) -> usize {
        let is_broken = |row: &&Row| row.held != Some(true);
        self.rows.iter().filter(is_broken).count()
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = self.rows.iter().map(|row| row.promise.len()).max();
        let width = width.unwrap_or(0);
        writeln!(f, "{:width$}  held        figure", "promise")?;
        for row in &self.rows {
            let held = match row.held {
                Some(true) => "yes",
                Some(false) => "NO",
                None => "not tested",
            };
            writeln!(f, "{:width$}  {held:10}  {}", row.promise, row.figure)?;
        }
        Ok(())
    }
}
