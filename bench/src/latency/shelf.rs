//! Rows that are done, in the folder of `--out`: a stopped measurement continues.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use supervisor::cli::failure::Failure;

use super::arguments::{Case, Settings};
use super::buckets::{self, Series};
use super::row::Row;
use supervisor::subcommand::write_json;

/// The folder, if there is one.
#[derive(Debug)]
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
    ///
    /// # Errors
    /// When it was done with others: no measurement is overwritten without --fresh.
    pub fn kept(&self, case: &Case, settings: &Settings) -> Result<Option<Row>, Failure> {
        let Some(row) = self.read(case) else {
            return Ok(None);
        };
        let unlike = row.settings.unlike(settings);
        match unlike.is_empty() {
            true => Ok(Some(row)),
            false => Err(Failure::Usage(format!(
                "--out: has '{}' already, measured with {unlike}; --fresh measures anew, or give \
                 another folder",
                case.words()
            ))),
        }
    }

    /// What cannot be read is measured anew.
    fn read(&self, case: &Case) -> Option<Row> {
        let text = fs::read_to_string(self.file(case, "json")?).ok()?;
        let row = serde_json::from_str(&text).ok()?;
        self.file(case, "csv")?.exists().then_some(row)
    }

    /// Removes a row, so that it is measured anew.
    pub fn forget(&self, case: &Case) {
        // What cannot be removed is reported as other settings, or when it is written anew.
        let _ = self.file(case, "json").map(fs::remove_file);
    }

    /// Keeps a row; it counts once its JSON is there, which comes last.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn keep(&self, case: &Case, row: &Row, series: &[Series]) -> anyhow::Result<()> {
        if let (Some(csv), Some(json)) = (self.file(case, "csv"), self.file(case, "json")) {
            self.forget(case);
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
        let kept = |case: &Case, settings: &Settings| shelf.kept(case, settings).expect("a look");
        assert_eq!(kept(&case, &row.settings), None);
        shelf.keep(&case, &row, &[]).expect("kept");
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
        let refused = shelf.kept(&case, &longer).expect_err("another row's file");
        let told = refused.to_string();
        let differ = "--seconds 20 in place of 60, --set nothing in place of planner.rate_hz=10;";
        assert!(told.contains(differ) && told.contains("--fresh"), "{told}");
        shelf.forget(&case);
        assert_eq!(kept(&case, &longer), None);
        let nowhere = Shelf::open(None).expect("no shelf");
        nowhere.keep(&case, &row, &[]).expect("nothing to do");
        assert_eq!(nowhere.kept(&case, &row.settings).expect("a look"), None);
    }
}
