//! The folder of finished rows in `--out`, so that a stopped measurement can continue.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;

/// The folder, if one was given.
#[derive(Debug)]
pub struct RowFolder(Option<PathBuf>);

impl RowFolder {
    /// Creates the folder.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn open(out: Option<&Path>) -> anyhow::Result<Self> {
        let folder = out.map(|out| out.join("rows"));
        if let Some(folder) = &folder {
            fs::create_dir_all(folder).with_context(|| format!("--out {}", folder.display()))?;
        }
        Ok(Self(folder))
    }

    /// Its path.
    pub fn path(&self) -> Option<&Path> {
        self.0.as_deref()
    }

    /// The path of a file in it.
    pub fn file(&self, name: &str) -> Option<PathBuf> {
        Some(self.0.as_ref()?.join(name))
    }
}
