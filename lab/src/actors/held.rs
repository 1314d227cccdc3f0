//! A block that was not finished leaves no trace: the replay on disk goes back to the end of
//! the block before.
//!
//! The learning session writes each transition at once, and its random numbers go on with
//! each. Of a block that was interrupted both are unknown, so the next start drives and learns
//! the block again from its beginning. The replay is appended to in place, or replaced as a
//! whole; a second name of the file and its length are therefore enough.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use anyhow::Context;
use learner::checkpoint::Checkpoint;
use serde::{Deserialize, Serialize};
use shm_config::file::{Durable, read_text, replace};

/// Largest note, bytes.
const BYTES_MAX: u64 = 1 << 10;

/// The replay at the end of a block.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct HeldReplay {
    /// Steps that were learnt from.
    steps: u64,
    /// Length of the replay, bytes.
    bytes: u64,
}

/// The files of a session in its folder.
struct Files {
    replay: PathBuf,
    held: PathBuf,
    note: PathBuf,
    checkpoint: PathBuf,
}

impl Files {
    fn of(folder: &Path) -> Files {
        Files {
            replay: folder.join("replay.bin"),
            held: folder.join("replay.held"),
            note: folder.join("held.json"),
            checkpoint: folder.join("learner.bin"),
        }
    }
}

fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        done => done,
    }
}

/// Holds the replay at the end of a block, after which so many steps were learnt from.
///
/// # Errors
/// If the folder cannot be written.
pub fn hold(folder: &Path, steps: u64) -> anyhow::Result<()> {
    let files = Files::of(folder);
    let named = || files.held.display().to_string();
    remove(&files.held).with_context(named)?;
    // A file system without second names gets a copy.
    fs::hard_link(&files.replay, &files.held)
        .or_else(|_| fs::copy(&files.replay, &files.held).map(drop))
        .with_context(named)?;
    let bytes = fs::metadata(&files.held).with_context(named)?.len();
    let note = serde_json::to_string(&HeldReplay { steps, bytes })?;
    // The note counts only once the file that it is about is there.
    replace(&files.note, note.as_bytes(), Durable::Yes)
        .with_context(|| files.note.display().to_string())
}

/// Goes back to the end of the last block, before the session is opened.
///
/// # Errors
/// If a file cannot be read or written, or is damaged.
pub fn restore(folder: &Path) -> anyhow::Result<()> {
    let files = Files::of(folder);
    let text = match read_text(&files.note, BYTES_MAX) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error).with_context(|| files.note.display().to_string()),
    };
    let note: HeldReplay =
        serde_json::from_str(&text).with_context(|| files.note.display().to_string())?;
    let left = Checkpoint::read(&files.checkpoint)
        .with_context(|| files.checkpoint.display().to_string())?;
    let learnt = left.map_or(0, |state| state.steps);
    if learnt != note.steps {
        // The block after it was finished, and none was begun since then.
        return Ok(());
    }
    let named = || files.held.display().to_string();
    let file = match File::options().write(true).open(&files.held) {
        Ok(file) => file,
        // It was moved to its place, and nothing was learnt since then.
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error).with_context(named),
    };
    file.set_len(note.bytes).with_context(named)?;
    file.sync_all().with_context(named)?;
    fs::rename(&files.held, &files.replay).with_context(named)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn what_was_appended_or_replaced_since_the_block_is_gone() {
        let place = tempfile::tempdir().expect("a folder");
        let replay = place.path().join("replay.bin");
        restore(place.path()).expect("a new folder");
        for is_replaced in [false, true] {
            fs::write(&replay, b"the block before").expect("written");
            hold(place.path(), 0).expect("held");
            match is_replaced {
                false => File::options()
                    .append(true)
                    .open(&replay)
                    .and_then(|mut file| file.write_all(b" and more"))
                    .expect("written"),
                true => replace(&replay, b"shorter", Durable::No).expect("replaced"),
            }
            restore(place.path()).expect("restored");
            assert_eq!(fs::read(&replay).expect("read"), b"the block before");
            // A kill between both steps.
            restore(place.path()).expect("restored again");
            assert_eq!(fs::read(&replay).expect("read"), b"the block before");
        }
    }
}
