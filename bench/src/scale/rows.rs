//! Finished rows in the folder of `--out`, so that a stopped measurement continues.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::{Deserialize, Serialize};
use shm_config::file::{Durable, replace};
use supervisor::cli::failure::Failure;

use super::sweep::{Cost, Late, Sweep};
use crate::rows::RowFolder;

/// Version of the way that rows are measured; other ones are not comparable.
const METHOD: u32 = 2;

/// The settings of a row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Seconds for each row.
    pub seconds: f64,
    /// Version of the way that rows are measured.
    pub method: u32,
    /// The build's commit; empty without `./vlaps`.
    pub commit: String,
}

impl Settings {
    /// Those of this build.
    pub fn of(seconds: f64) -> Settings {
        Settings {
            seconds,
            method: METHOD,
            commit: std::env::var("VLAPS_COMMIT").unwrap_or_default(),
        }
    }

    fn difference(&self, asked: &Settings) -> Option<String> {
        let all = [
            (
                "--seconds",
                self.seconds.to_string(),
                asked.seconds.to_string(),
            ),
            ("method", self.method.to_string(), asked.method.to_string()),
            ("commit", self.commit.clone(), asked.commit.clone()),
        ];
        let differing = all.into_iter().find(|(_, was, now)| was != now);
        differing.map(|(what, was, now)| format!("{what} {was:?} in place of {now:?}"))
    }
}

/// One amount of work with its cost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// What was asked for; names the row's file.
    pub value: u64,
    /// The amount of work.
    pub work: f64,
    /// Median of the turns.
    pub median: f64,
    /// Their quartiles.
    pub quartiles: [f64; 2],
    /// Number of turns.
    pub turns: usize,
    /// Late ticks, of sets alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub late: Option<Late>,
    /// How it was measured.
    pub settings: Settings,
}

impl Row {
    /// Of a measured cost.
    pub fn new(value: u64, cost: &Cost, settings: &Settings) -> Row {
        let [median, low, high] = cost.quartiles();
        Row {
            value,
            work: cost.work,
            median,
            quartiles: [low, high],
            turns: cost.turns.len(),
            late: cost.late,
            settings: settings.clone(),
        }
    }

    /// Whether the sweep ends here: sets are late where the floor is not.
    pub fn ends_sweep(&self) -> bool {
        self.late.is_some_and(|late| late.sets > late.floor)
    }
}

/// The rows in the folder of finished ones, if one was given.
#[derive(Debug)]
pub struct RowStore(RowFolder);

impl RowStore {
    /// Creates the folder.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn open(out: Option<&Path>) -> anyhow::Result<Self> {
        RowFolder::open(out).map(Self)
    }

    fn file(&self, sweep: Sweep, value: u64) -> Option<PathBuf> {
        self.0.file(&format!("{}-{value}.json", sweep.word()))
    }

    /// The row if it was measured with the same settings. A row that cannot be read is
    /// measured again.
    ///
    /// # Errors
    /// If it was measured with other settings: only --fresh replaces a measurement.
    pub fn kept(
        &self,
        sweep: Sweep,
        value: u64,
        settings: &Settings,
    ) -> anyhow::Result<Option<Row>> {
        let Some(file) = self.file(sweep, value) else {
            return Ok(None);
        };
        let text = fs::read_to_string(&file).unwrap_or_default();
        let Ok(row) = serde_json::from_str::<Row>(&text) else {
            return Ok(None);
        };
        match row.settings.difference(settings) {
            None => Ok(Some(row)),
            Some(difference) => Err(Failure::Usage(format!(
                "{}: was measured with {difference}; --fresh measures it again, or give another \
                 folder",
                file.display()
            ))
            .into()),
        }
    }

    /// Keeps a row.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn keep(&self, sweep: Sweep, row: &Row) -> anyhow::Result<()> {
        let Some(file) = self.file(sweep, row.value) else {
            return Ok(());
        };
        let text = serde_json::to_string_pretty(row)?;
        let written = replace(&file, text.as_bytes(), Durable::No);
        written.with_context(|| file.display().to_string())
    }

    /// Removes the rows of a sweep, so that they are measured again.
    pub fn forget(&self, sweep: Sweep) {
        let entries = self.0.path().and_then(|folder| fs::read_dir(folder).ok());
        for entry in entries.into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let rest = name.strip_prefix(sweep.word());
            let value = rest.and_then(|rest| rest.strip_prefix('-')?.strip_suffix(".json"));
            if value.is_some_and(|value| value.parse::<u64>().is_ok()) {
                // If the removal fails, `kept` reports other settings later.
                let _ = fs::remove_file(entry.path());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_kept_and_other_settings_are_refused() {
        let place = tempfile::tempdir().expect("a folder");
        let store = RowStore::open(Some(place.path())).expect("a store");
        let settings = Settings::of(2.0);
        let cost = Cost {
            work: 30.0,
            turns: vec![3.0, 1.0, 2.0],
            late: None,
        };
        let row = Row::new(30, &cost, &settings);
        assert_eq!((row.median, row.turns), (2.0, 3));
        store.keep(Sweep::Beams, &row).expect("kept");
        let kept = |seconds| store.kept(Sweep::Beams, 30, &Settings::of(seconds));
        assert_eq!(kept(2.0).expect("a row"), Some(row));
        let error = kept(3.0).expect_err("other seconds").to_string();
        assert!(error.contains("--seconds"), "{error}");
        // A torn file is measured again.
        let file = place.path().join("rows/beams-30.json");
        let text = fs::read(&file).expect("the row");
        fs::write(&file, &text[..text.len() / 2]).expect("written");
        assert_eq!(kept(2.0).expect("none"), None);
        store.forget(Sweep::Beams);
        assert!(!file.exists());
    }
}
