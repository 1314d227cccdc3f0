//! What is wrong with a recording, in one line each.

use std::io;
use std::path::PathBuf;

use crate::FORMAT;

/// Why a recording cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The system refused to read or write.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A folder without a recording.
    #[error("{0}: the folder has no file ending in .mcap; give a recording's folder or file")]
    Empty(PathBuf),
    /// A folder with the recordings of several runs.
    #[error(
        "{folder}: holds the recordings of {sessions} runs; give one of them, such as {example}"
    )]
    Mixed {
        /// The folder.
        folder: PathBuf,
        /// How many runs.
        sessions: usize,
        /// The first file of one of them.
        example: PathBuf,
    },
    /// A folder with the recording of another run, into which this one would be written.
    #[error(
        "{folder}: holds a recording of another start of run '{run}'; choose a new folder, or \
         delete that recording"
    )]
    Taken {
        /// The folder.
        folder: PathBuf,
        /// The run that it is of.
        run: String,
    },
    /// A file that is no recording of this project.
    #[error("{path}: is no recording of vlaps: {what}")]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What shows it.
        what: String,
    },
    /// A file that ends before its metadata.
    #[error(
        "{path}: has {bytes} bytes and ends before its beginning is complete; its recorder was \
         stopped, or it is no recording of vlaps"
    )]
    Unbegun {
        /// The file.
        path: PathBuf,
        /// Its bytes.
        bytes: u64,
    },
    /// A recording of a later format.
    #[error("{path}: has recording format {format}, this binary reads {FORMAT}; update vlaps")]
    Newer {
        /// The file.
        path: PathBuf,
        /// The file's format.
        format: u32,
    },
    /// A part of a file whose content is wrong.
    #[error("{path}: {part} at byte {offset} is damaged: {what}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Which part.
        part: &'static str,
        /// Its first byte.
        offset: u64,
        /// What is wrong.
        what: String,
    },
    /// A service whose messages have another layout than this binary's.
    #[error(
        "{path}: service '{service}' was recorded with message layout {theirs}, this binary has \
         {ours}; read it with the build that recorded it (commit {commit})"
    )]
    Layout {
        /// The file.
        path: PathBuf,
        /// The service.
        service: String,
        /// The recording's layout.
        theirs: String,
        /// This binary's.
        ours: String,
        /// The commit of the recorder.
        commit: String,
    },
    /// The MCAP library refused to write.
    #[error("the recording cannot be written: {0}")]
    Write(mcap::McapError),
}

impl RecordingError {
    /// The system's error, at a path.
    pub(crate) fn io(path: &std::path::Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, source }
    }
}

impl From<mcap::McapError> for RecordingError {
    fn from(error: mcap::McapError) -> Self {
        Self::Write(error)
    }
}
