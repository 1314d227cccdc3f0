//! The active weights, kept on disk for a restart of controller or run.

use std::io;
use std::path::PathBuf;

use shm_config::file::{Durable, Entry, Folder};
use shm_config::message::WEIGHTS_BYTES_MAX;

/// The file.
const FILE: &str = "policy-good.onnx";
/// Beside it: version, SHA-256 of the file, and the run's id.
const NOTE: &str = "policy-good.txt";
/// Longest note that is read, bytes: two numbers of twenty digits and a hash of 64.
const NOTE_BYTES_MAX: u64 = 256;

/// Weights with their version.
#[derive(Debug, Clone)]
pub struct LastGood {
    /// Of the run.
    pub version: u64,
    /// The policy file.
    pub bytes: Vec<u8>,
}

/// The file in the run's folder.
pub struct LastGoodFile {
    folder: PathBuf,
    /// The supervisor's process, which outlives its controllers.
    run: u32,
}

impl LastGoodFile {
    /// In this folder; nothing is read yet.
    pub fn new(folder: &str) -> Self {
        Self {
            folder: folder.into(),
            run: std::os::unix::process::parent_id(),
        }
    }

    /// The kept weights, if they are complete. If the note belongs to another file, the
    /// version begins at 1.
    pub fn read(&self) -> Option<LastGood> {
        let bytes = self
            .open()
            .ok()?
            .read(FILE, WEIGHTS_BYTES_MAX as u64)
            .ok()?;
        let hash = hex(&policy::sha256(&bytes));
        let version = self
            .note()
            .filter(|note| note.hash == hash)
            .map_or(1, |note| note.version);
        Some(LastGood { version, bytes })
    }

    /// It was written under the supervisor that lives: the controller was
    /// restarted.
    pub fn is_of_this_run(&self) -> bool {
        self.note().is_some_and(|note| note.run == self.run)
    }

    /// Keeps these weights, or none: whole or not at all, whenever the machine
    /// stops.
    ///
    /// # Errors
    /// When the disk refuses; what was kept before stays.
    pub fn write(&self, good: Option<&LastGood>) -> io::Result<()> {
        let folder = self.open()?;
        let Some(good) = good else {
            return match folder.remove(FILE) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
                _ => Ok(()),
            };
        };
        let note = format!(
            "{} {} {}\n",
            good.version,
            hex(&policy::sha256(&good.bytes)),
            self.run
        );
        // The note first: a note whose hash is not the file's is ignored.
        folder.replace(NOTE, note.as_bytes(), Durable::Yes)?;
        folder.replace(FILE, &good.bytes, Durable::Yes)
    }

    /// Each time anew: the run's folder is checked whenever it is used.
    fn open(&self) -> io::Result<Folder> {
        Folder::open(&self.folder, Entry::Readable)
    }

    fn note(&self) -> Option<Note> {
        let text = self.open().ok()?.read_text(NOTE, NOTE_BYTES_MAX).ok()?;
        let mut words = text.split_whitespace();
        Some(Note {
            version: words.next()?.parse().ok()?,
            hash: words.next()?.into(),
            run: words.next()?.parse().ok()?,
        })
    }
}

struct Note {
    version: u64,
    hash: String,
    run: u32,
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
