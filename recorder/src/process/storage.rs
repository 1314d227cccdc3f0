//! Where the files of a recording are, and the space that they may have.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use super::date;
use crate::read::{ENDING, origin_of};
use crate::{Origin, RecordingError};

/// A file has at most this part of the space of all, beside its attachments.
const FILES_MIN: u64 = 8;
/// Files that may begin in one second.
const NAMES_MAX: u32 = 100;

/// Where the files are, and how much space they may have.
#[derive(Debug, Clone)]
pub(super) struct Storage {
    /// The folder of this recording.
    pub(super) folder: PathBuf,
    /// The folder whose recordings share the limit: this one or the one above.
    pub(super) root: PathBuf,
    /// Bytes of all of them.
    pub(super) bytes_max: u64,
}

impl Storage {
    /// Bytes that the messages of one file may have.
    pub(super) fn file_bytes_max(&self) -> u64 {
        self.bytes_max / FILES_MIN
    }

    /// Deletes the oldest files of this run, so that so many more bytes fit below the limit.
    pub(super) fn free_space(&self, run: &str, wanted: u64) {
        let mut files = self.recordings(run);
        let mut bytes: u64 = files.iter().map(|(_, _, bytes)| bytes).sum();
        files.sort_unstable();
        for (_, path, length) in files {
            if bytes.saturating_add(wanted) <= self.bytes_max {
                return;
            }
            match fs::remove_file(&path) {
                Ok(()) => bytes -= length,
                Err(error) => tracing::warn!(%error, path = %path.display(), "cannot be deleted"),
            }
            if let Some(folder) = path.parent().filter(|folder| *folder != self.folder) {
                // Refused while it has files.
                let _ = fs::remove_dir(folder);
            }
        }
    }

    /// The recordings of a run of this name: when each was last written, its path and its
    /// bytes. Files of other runs and other programs are not among them, because this is the
    /// list from which the oldest are deleted. The folders in the root are the run's own only
    /// where this recording's is one of them.
    fn recordings(&self, run: &str) -> Vec<(SystemTime, PathBuf, u64)> {
        let entries = |folder: &Path| fs::read_dir(folder).into_iter().flatten().flatten();
        let mut folders = vec![self.root.clone()];
        if self.root != self.folder {
            let inner = entries(&self.root)
                .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()));
            folders.extend(inner.map(|entry| entry.path()));
        }
        let mut files = Vec::new();
        for entry in folders.iter().flat_map(|folder| entries(folder)) {
            let path = entry.path();
            if let Ok(metadata) = entry.metadata()
                && is_recording(&path)
                && metadata.is_file()
                && is_of(&path, run)
            {
                let written = metadata.modified().unwrap_or(UNIX_EPOCH);
                files.push((written, path, metadata.len()));
            }
        }
        files
    }
}

/// Whether a file's name is that of a recording.
pub(super) fn is_recording(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == ENDING)
}

fn is_of(path: &Path, run: &str) -> bool {
    origin_of(path).is_ok_and(|Origin { run: of, .. }| of == run)
}

/// Creates a file that does not exist yet, named after the run and the time.
pub(super) fn create(folder: &Path, name: &str) -> Result<(PathBuf, File), RecordingError> {
    let stamp = date::stamp(super::epoch_ns() / 1_000_000_000);
    for again in 0..NAMES_MAX {
        let again = match again {
            0 => String::new(),
            again => format!("-{again}"),
        };
        let path = folder.join(format!("{name}-{stamp}{again}.{ENDING}"));
        match File::options().write(true).create_new(true).open(&path) {
            Ok(file) => return Ok((path, file)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(RecordingError::io(&path)(error)),
        }
    }
    Err(RecordingError::io(folder)(
        io::ErrorKind::AlreadyExists.into(),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Writer;

    fn write(path: &Path, run: &str) {
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        let origin = Origin {
            run: run.into(),
            ..Origin::default()
        };
        let writer = Writer::create(path, &origin).expect("a file");
        writer.finish().expect("finished");
    }

    #[test]
    fn only_files_of_this_run_are_deleted() {
        let place = tempfile::tempdir().expect("a folder");
        let at = |name: &str| place.path().join(name);
        let stays = ["other.mcap", "foreign.mcap", "inner/mine.mcap"];
        write(&at("mine.mcap"), "mine");
        write(&at(stays[0]), "other");
        fs::write(at(stays[1]), b"a file of another program").expect("written");
        write(&at(stays[2]), "mine");
        let storage = |folder: PathBuf| Storage {
            folder,
            root: place.path().into(),
            bytes_max: 0,
        };
        storage(place.path().into()).free_space("mine", 1);
        assert!(!at("mine.mcap").exists());
        for name in stays {
            assert!(at(name).exists(), "{name}");
        }
        // A run's own folder has one for each start of the run.
        storage(at("now")).free_space("mine", 1);
        assert!(!at(stays[2]).exists());
        for name in &stays[..2] {
            assert!(at(name).exists(), "{name}");
        }
    }
}
