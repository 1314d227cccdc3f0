//! Rows that are done, in the folder of `--out`: who stops goes on.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;

use super::arguments::{Case, Settings};
use super::buckets::{self, Series};
use super::row::Row;
use crate::report::write_json;

/// The folder, if there is one.
pub struct Shelf {
    folder: Option<PathBuf>,
}

impl Shelf {
    /// Makes the folder.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn open(out: Option<&Path>) -> anyhow::Result<Self> {
        let folder = out.map(|out| out.join("rows"));
        if let Some(folder) = &folder {
            fs::create_dir_all(folder).with_context(|| format!("--out {}", folder.display()))?;
        }
        Ok(Self { folder })
    }

    fn file(&self, case: &Case, ending: &str) -> Option<PathBuf> {
        let folder = self.folder.as_ref()?;
        Some(folder.join(format!("{}.{ending}", case.slug())))
    }

    /// A row that was done with the same settings.
    pub fn kept(&self, case: &Case, settings: &Settings) -> Option<Row> {
        let text = fs::read_to_string(self.file(case, "json")?).ok()?;
        // What cannot be read is measured anew.
        let row: Row = serde_json::from_str(&text).ok()?;
        (row.settings == *settings && self.file(case, "csv")?.exists()).then_some(row)
    }

    /// Keeps a row; it counts once its JSON is there, which comes last.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn keep(&self, case: &Case, row: &Row, series: &[Series]) -> anyhow::Result<()> {
        if let (Some(csv), Some(json)) = (self.file(case, "csv"), self.file(case, "json")) {
            let _ = fs::remove_file(&json);
            buckets::write(&csv, series)?;
            write_json(&json, row)?;
        }
        Ok(())
    }

    /// The histograms of each case, in order; of none that is not done.
    ///
    /// # Errors
    /// When a file cannot be read.
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
        let shelf = Shelf::open(Some(out.path())).expect("a shelf");
        let case = Case {
            rate_hz: 100.0,
            priority: Priority::Asked,
            beside: Load::None.rows()[0],
        };
        let row = row();
        assert_eq!(shelf.kept(&case, &row.settings), None);
        shelf.keep(&case, &row, &[]).expect("kept");
        assert_eq!(shelf.kept(&case, &row.settings), Some(row.clone()));
        let longer = Settings {
            seconds: 60.0,
            ..row.settings.clone()
        };
        assert_eq!(shelf.kept(&case, &longer), None);
        let other = Case {
            rate_hz: 10.0,
            ..case
        };
        assert_eq!(shelf.kept(&other, &row.settings), None);
        let nowhere = Shelf::open(None).expect("no shelf");
        nowhere.keep(&case, &row, &[]).expect("nothing to do");
        assert_eq!(nowhere.kept(&case, &row.settings), None);
    }
}
