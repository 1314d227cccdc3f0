//! The weights in charge, kept on disk for a restart of controller or run.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The file.
const FILE: &str = "policy-good.onnx";
/// Beside it: version, SHA-256 of the file, and the run's id.
const NOTE: &str = "policy-good.txt";

/// Weights with their version.
#[derive(Debug, Clone)]
pub struct Good {
    /// Of the run.
    pub version: u64,
    /// The policy file.
    pub bytes: Vec<u8>,
}

/// The file in the run's folder.
pub struct GoodFile {
    folder: PathBuf,
    /// The supervisor's process, which outlives its controllers.
    run: u32,
}

impl GoodFile {
    /// In this folder; nothing is read yet.
    pub fn new(folder: &str) -> Self {
        Self {
            folder: folder.into(),
            run: std::os::unix::process::parent_id(),
        }
    }

    /// What is kept, if it is whole. Where the note is of another file, the
    /// version begins at 1.
    pub fn read(&self) -> Option<Good> {
        let bytes = fs::read(self.folder.join(FILE)).ok()?;
        let hash = hex(&policy::sha256(&bytes));
        let version = self
            .note()
            .filter(|note| note.hash == hash)
            .map_or(1, |note| note.version);
        Some(Good { version, bytes })
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
    pub fn write(&self, good: Option<&Good>) -> io::Result<()> {
        let file = self.folder.join(FILE);
        let Some(good) = good else {
            return match fs::remove_file(&file) {
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
        // The note first: with another file beside it, it is not believed.
        replace(&self.folder.join(NOTE), note.as_bytes())?;
        replace(&file, &good.bytes)
    }

    fn note(&self) -> Option<Note> {
        let text = fs::read_to_string(self.folder.join(NOTE)).ok()?;
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

/// The old content or the new, never a part: written beside, flushed, renamed.
fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let beside = path.with_extension("new");
    let mut file = File::create(&beside)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&beside, path)
}
