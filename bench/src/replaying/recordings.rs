//! The rehearsed runs as files.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use lab::replay::rehearsal::{Rehearsal, policy_file};
use stack::Clock;
use supervisor::cli::failure::Failure;

use super::{BenchReplay, in_parallel};

/// The seed of the policy with which forks drive on.
const POLICY: u64 = 9;

/// The recordings, removed at the end unless they are kept.
pub(super) struct Recordings {
    files: Vec<PathBuf>,
    policy: PathBuf,
    /// Removes the folder when it is dropped.
    _folder: Option<tempfile::TempDir>,
}

impl Recordings {
    /// Rehearses the runs and writes them; each is a folder with one file.
    pub(super) fn rehearse(arguments: &BenchReplay, clock: Clock) -> anyhow::Result<Self> {
        let (root, own) = match &arguments.keep {
            Some(folder) => {
                fs::create_dir(folder).map_err(|error| {
                    Failure::Usage(format!("--keep {}: {error}", folder.display()))
                })?;
                (folder.clone(), None)
            }
            None => {
                let own = tempfile::tempdir().context("a temporary folder")?;
                (own.path().to_path_buf(), Some(own))
            }
        };
        let policy = root.join("policy.onnx");
        fs::write(&policy, policy_file(POLICY)?.bytes)
            .with_context(|| policy.display().to_string())?;
        let seeds: Vec<u64> = (0..arguments.recordings).collect();
        let ticks = arguments.ticks as usize;
        let files = in_parallel(("rehearse", "recordings"), &seeds, clock, |seed| {
            rehearse(&root, *seed, ticks).with_context(|| format!("seed {seed}"))
        })?;
        Ok(Self {
            files,
            policy,
            _folder: own,
        })
    }

    pub(super) fn files(&self) -> &[PathBuf] {
        &self.files
    }

    pub(super) fn policy(&self) -> &Path {
        &self.policy
    }

    /// Bytes of all files.
    pub(super) fn bytes(&self) -> anyhow::Result<u64> {
        let lengths = self.files.iter().map(|path| Ok(fs::metadata(path)?.len()));
        lengths.sum()
    }
}

fn rehearse(root: &Path, seed: u64, ticks: usize) -> anyhow::Result<PathBuf> {
    let folder = root.join(format!("{seed:04}"));
    fs::create_dir(&folder).with_context(|| folder.display().to_string())?;
    let path = folder.join("run-0001.mcap");
    Rehearsal::troubled(seed)?.run(ticks)?.save(&path)?;
    Ok(path)
}
