//! The folder of a recording.

use std::fs;
use std::path::Path;

use sha2::{Digest, Sha256};
use shm_config::config::Config;
use shm_config::file;

use super::storage::{Storage, is_recording};
use super::{date, epoch_ns, facts};
use crate::RecordingError;
use crate::read::origin_of;

/// The folder in the run's folder that has a folder for each start of the run.
const FOLDER: &str = "recording";

/// Where a recording goes, and what is there already.
pub(super) struct RecordingFolder {
    pub(super) storage: Storage,
    /// The epoch offset of the files that are there already; `None` without files.
    pub(super) offset_ns: Option<u64>,
    /// Whether the recorder is there from the run's start.
    pub(super) from_start: bool,
}

impl RecordingFolder {
    /// The place that a run's configuration names.
    ///
    /// # Errors
    /// When it has another run's recording, or cannot be made.
    pub(super) fn of_run(config: &Config, supervisor: u32) -> Result<Self, RecordingError> {
        if !config.record.folder.is_empty() {
            return Self::at(Path::new(&config.record.folder), config, supervisor);
        }
        let root = Path::new(&config.run.folder).join(FOLDER);
        // A recorder that was restarted goes on in the folder of its run.
        let folders = fs::read_dir(&root).into_iter().flatten().flatten();
        let session = facts::session(supervisor);
        let own = folders.map(|entry| entry.path()).find(|path| {
            let files = fs::read_dir(path).into_iter().flatten().flatten();
            let mut origins = files.filter_map(|entry| origin_of(&entry.path()).ok());
            origins.any(|origin| origin.session == session)
        });
        let folder = own.unwrap_or_else(|| root.join(date::stamp(epoch_ns() / 1_000_000_000)));
        let mut place = Self::at(&folder, config, supervisor)?;
        place.storage.root = root;
        Ok(place)
    }

    /// This folder, which is made when it is missing.
    ///
    /// # Errors
    /// As [`RecordingFolder::of_run`].
    pub(super) fn at(
        folder: &Path,
        config: &Config,
        supervisor: u32,
    ) -> Result<Self, RecordingError> {
        file::make_folders(folder).map_err(RecordingError::io(folder))?;
        let storage = Storage {
            folder: folder.into(),
            root: folder.into(),
            bytes_max: u64::from(config.record.max_mb) << 20,
        };
        let session = facts::session(supervisor);
        let entries = fs::read_dir(folder).map_err(RecordingError::io(folder))?;
        let mut offset_ns = None;
        let paths = entries.flatten().map(|entry| entry.path());
        for path in paths.filter(|path| is_recording(path)) {
            match origin_of(&path) {
                Ok(there) if there.session == session => {
                    offset_ns = Some(there.epoch_offset_ns);
                }
                Ok(there) => {
                    return Err(RecordingError::Taken {
                        folder: folder.into(),
                        run: there.run,
                    });
                }
                // A recorder that was killed as it began a file left it.
                Err(error @ RecordingError::Unbegun { .. }) => tracing::warn!("{error}"),
                // It may be another program's.
                Err(error) => return Err(error),
            }
        }
        Ok(Self {
            storage,
            from_start: offset_ns.is_none(),
            offset_ns,
        })
    }
}

/// The SHA-256 of a file in hexadecimal.
pub(super) fn sha256(bytes: &[u8]) -> String {
    facts::hex(&Sha256::digest(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Origin, Writer};

    #[test]
    fn a_folder_with_a_file_of_another_program_or_run_is_refused() {
        let place = tempfile::tempdir().expect("a folder");
        let (config, supervisor) = (Config::default(), std::process::id());
        let at =
            || RecordingFolder::at(place.path(), &config, supervisor).map(|place| place.offset_ns);
        let path = place.path().join("there.mcap");
        let write = |session: String| {
            let origin = Origin {
                session,
                epoch_offset_ns: 7,
                ..Origin::default()
            };
            let writer = Writer::create(&path, &origin).expect("a file");
            writer.finish().expect("finished");
        };
        assert_eq!(at().expect("an empty folder"), None);
        write(facts::session(supervisor));
        assert_eq!(at().expect("the run's own"), Some(7));
        write("another".into());
        let refused = at().expect_err("another start's").to_string();
        assert!(refused.contains("another start"), "{refused}");
        fs::write(&path, b"a picture of another program").expect("written");
        let refused = at().expect_err("another program's").to_string();
        assert!(refused.contains("there.mcap: is no recording"), "{refused}");
        // Killed as it began the file.
        fs::write(&path, b"").expect("written");
        assert_eq!(at().expect("the run's own"), None);
    }
}
