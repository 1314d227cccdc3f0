//! Finished rows in the folder of `--out`, so that a stopped measurement can continue.

use std::fs;
use std::path::{Path, PathBuf};

use supervisor::cli::failure::Failure;

use super::arguments::{Case, Settings};
use super::buckets::{self, Series};
use super::row::Row;
use crate::rows::RowFolder;
use supervisor::subcommand::write_json;

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

    fn file(&self, case: &Case, ending: &str) -> Option<PathBuf> {
        self.0.file(&format!("{}.{ending}", case.slug()))
    }

    /// The row of a case if it was measured with the same settings.
    ///
    /// # Errors
    /// If it was measured with other settings: only --fresh replaces a measurement.
    pub fn kept(&self, case: &Case, settings: &Settings) -> Result<Option<Row>, Failure> {
        let Some(row) = self.read(case) else {
            return Ok(None);
        };
        let differences = row.settings.differences(settings);
        match differences.is_empty() {
            true => Ok(Some(row)),
            false => Err(Failure::Usage(format!(
                "--out: holds '{}' already, measured with {differences}; --fresh measures it again, or \
                 give another folder",
                case.words()
            ))),
        }
    }

    /// A row that cannot be read is measured again.
    fn read(&self, case: &Case) -> Option<Row> {
        let text = fs::read_to_string(self.file(case, "json")?).ok()?;
        let row = serde_json::from_str(&text).ok()?;
        self.file(case, "csv")?.exists().then_some(row)
    }

    /// Removes a row, so that it is measured again.
    pub fn forget(&self, case: &Case) {
        // If the removal fails, `kept` or `keep` reports an error later.
        let _ = self.file(case, "json").map(fs::remove_file);
    }

    /// Writes a row. Its JSON file is written last: only with it is the row complete.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn keep(&self, case: &Case, row: &Row, series: &[Series]) -> anyhow::Result<()> {
        if let (Some(csv), Some(json)) = (self.file(case, "csv"), self.file(case, "json")) {
            self.forget(case);
            buckets::write(&csv, series)?;
            write_json(&json, row)?;
        }
        Ok(())
    }

    /// The histograms of each finished case, in order.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn series(&self, cases: &[Case]) -> anyhow::Result<Vec<Vec<Series>>> {
        let done = cases.iter().filter_map(|case| self.file(case, "csv"));
        let done = done.filter(|path| path.exists());
        done.map(|path| buckets::read(&path)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::floor::Priority;
    use crate::latency::arguments::Load;
    use crate::latency::row::tests::row;

    #[test]
    fn a_row_is_kept_for_its_own_settings_alone() {
        let out = tempfile::tempdir().expect("a folder");
        let store = RowStore::open(Some(out.path())).expect("a store");
        let case = Case {
            rate_hz: 100.0,
            priority: Priority::Asked,
            beside: Load::None.rows()[0],
            pair: None,
        };
        let row = row();
        let kept = |case: &Case, settings: &Settings| store.kept(case, settings).expect("a look");
        assert_eq!(kept(&case, &row.settings), None);
        store.keep(&case, &row, &[]).expect("kept");
        assert_eq!(kept(&case, &row.settings), Some(row.clone()));
        let other = Case {
            rate_hz: 10.0,
            ..case
        };
        assert_eq!(kept(&other, &row.settings), None);
        let longer = Settings {
            seconds: 60.0,
            overrides: vec!["planner.rate_hz=10".into()],
            ..row.settings.clone()
        };
        let refused = store.kept(&case, &longer).expect_err("another row's file");
        let message = refused.to_string();
        let differ = "--seconds 20 in place of 60, --set nothing in place of planner.rate_hz=10;";
        assert!(
            message.contains(differ) && message.contains("--fresh"),
            "{message}"
        );
        store.forget(&case);
        assert_eq!(kept(&case, &longer), None);
        let nowhere = RowStore::open(None).expect("no store");
        nowhere.keep(&case, &row, &[]).expect("nothing to do");
        assert_eq!(nowhere.kept(&case, &row.settings).expect("a look"), None);
    }
}
