//! Begins or continues a part in the folder of `--out`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Serialize;
use serde::de::DeserializeOwned;
use shm_config::counted;
use supervisor::cli::failure::Failure;
use supervisor::subcommand::say;

use super::Shard;
use super::lines::{self, Header, OtherFormat};
use super::merge::{Found, found};
use super::terms::Terms;

/// A part that this process works on; no other process can meanwhile.
pub struct ShardWork {
    path: PathBuf,
    file: File,
    left: BTreeSet<u64>,
    total: u64,
    shard: Shard,
    _lock: File,
}

impl ShardWork {
    /// Begins the part or continues it; `T` is the result of a piece. The terms are those of the command line; `label`
    /// names what is driven.
    ///
    /// # Errors
    /// If another process works on the part, the folder holds a part of other work, or it
    /// cannot be written.
    pub fn open<T: Serialize + DeserializeOwned + PartialEq>(
        out: &Path,
        shard: Shard,
        terms: &Terms,
        (pieces, label): (u64, &str),
    ) -> anyhow::Result<ShardWork> {
        shm_config::file::make_folders(out).with_context(|| out.display().to_string())?;
        let lock = lock(out, shard)?;
        let header = Header::new(shard, (pieces, label), terms);
        check_terms(out, &header)?;
        let path = out.join(shard.file_name());
        let is_new = !path.exists();
        let done = match is_new {
            true => BTreeMap::new(),
            false => kept::<T>(&path, shard)?,
        };
        if is_new || !path.exists() {
            lines::write(&path, &header, &done)?;
            // A part of other work may have begun at the same moment.
            if let Err(error) = check_terms(out, &header) {
                let _ = fs::remove_file(&path);
                return Err(error);
            }
        }
        let file = File::options().append(true).open(&path);
        let range = shard.range(pieces);
        Ok(ShardWork {
            file: file.with_context(|| path.display().to_string())?,
            path,
            total: range.end - range.start,
            left: range.filter(|piece| !done.contains_key(piece)).collect(),
            shard,
            _lock: lock,
        })
    }

    /// Takes back the finished pieces that `is_there` refuses, such as those whose files are
    /// gone: they are left again.
    ///
    /// # Errors
    /// Those of `is_there`, and if the file cannot be written.
    pub fn redo_unless<T: Serialize + DeserializeOwned + PartialEq>(
        &mut self,
        mut is_there: impl FnMut(u64, &T) -> anyhow::Result<bool>,
    ) -> anyhow::Result<()> {
        let mut content = lines::read::<T>(&self.path, self.shard)?;
        let before = content.results.len();
        for (piece, result) in std::mem::take(&mut content.results) {
            match is_there(piece, &result)? {
                true => drop(content.results.insert(piece, result)),
                false => drop(self.left.insert(piece)),
            }
        }
        if content.results.len() < before {
            lines::write(&self.path, &content.header, &content.results)?;
            let file = File::options().append(true).open(&self.path);
            self.file = file.with_context(|| self.path.display().to_string())?;
        }
        Ok(())
    }

    /// The pieces that are left.
    pub fn left(&self) -> &BTreeSet<u64> {
        &self.left
    }

    /// Number of finished pieces, and of all pieces of the part.
    pub fn progress(&self) -> (u64, u64) {
        (self.total - self.left.len() as u64, self.total)
    }

    /// Keeps the result of a piece; after a kill it is there.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn keep<T: Serialize>(&mut self, piece: u64, result: &T) -> anyhow::Result<()> {
        // A piece that is there already is not written a second time.
        if self.left.contains(&piece) {
            lines::append((&mut self.file, &self.path), piece, result)?;
            self.left.remove(&piece);
        }
        Ok(())
    }

    /// Prints that the part was complete before, if it was; whether it was.
    pub fn was_complete(&self, unit: &str) -> bool {
        if self.left.is_empty() {
            say(format_args!(
                "shard {}: complete already, {}; nothing to do: {}",
                self.shard,
                counted(self.total, unit),
                self.path.display()
            ));
        }
        self.left.is_empty()
    }

    /// Puts the results on the disk and prints what the part holds now.
    ///
    /// # Errors
    /// If pieces are left after a stop, or the file cannot be written.
    pub fn finish(self, unit: &str) -> anyhow::Result<()> {
        self.file
            .sync_all()
            .with_context(|| self.path.display().to_string())?;
        let (done, total) = self.progress();
        if done < total {
            return Err(Failure::GivenUp(format!(
                "stopped after {done} of {} of shard {}; the same command continues",
                counted(total, unit),
                self.shard
            ))
            .into());
        }
        say(format_args!(
            "shard {}: complete, {}: {}",
            self.shard,
            counted(total, unit),
            self.path.display()
        ));
        Ok(())
    }
}

/// Locks a part until the file is dropped or the process ends.
fn lock(out: &Path, shard: Shard) -> anyhow::Result<File> {
    let path = out.join(format!(".shard-{}-of-{}.lock", shard.number, shard.of));
    let named = || path.display().to_string();
    let mut options = File::options();
    let file = options.write(true).create(true).truncate(false);
    let file = file.open(&path).with_context(named)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(Failure::Usage(format!(
            "--shard {shard}: another process works on this shard in {}; wait for its end or stop \
             it",
            out.display()
        ))
        .into()),
        Err(TryLockError::Error(error)) => Err(error).with_context(named),
    }
}

/// Checks that all parts in the folder are of the work that the header describes.
fn check_terms(out: &Path, asked: &Header) -> anyhow::Result<()> {
    for Found { path, header, .. } in found(out)? {
        let header = match header {
            Ok(header) => header,
            Err(error) if error.downcast_ref::<OtherFormat>().is_some() => {
                return Err(Failure::Usage(format!(
                    "{}: {error}; use the build that began it, or another folder with --out DIR",
                    path.display()
                ))
                .into());
            }
            // An unreadable file of another part is that part's to repair.
            Err(_) => continue,
        };
        let mut difference = header.terms.difference(&asked.terms);
        if header.pieces != asked.pieces {
            let pieces = format!("number of pieces {}, not {}", header.pieces, asked.pieces);
            difference.get_or_insert(pieces);
        }
        if let Some(difference) = difference {
            return Err(Failure::Usage(format!(
                "{}: belongs to other work: {difference}; give the same options with the same \
                 build, or another folder with --out DIR",
                path.display()
            ))
            .into());
        }
    }
    Ok(())
}

/// The results in the part's own file. A damaged file is written anew without its damaged
/// lines, and a copy of it stays; a file without a readable header is moved away.
///
/// # Errors
/// If the file cannot be read now: its results may be whole, and another attempt may succeed.
fn kept<T: Serialize + DeserializeOwned + PartialEq>(
    path: &Path,
    shard: Shard,
) -> anyhow::Result<BTreeMap<u64, T>> {
    let named = || path.display().to_string();
    let copy = damaged_copy(path);
    match lines::read::<T>(path, shard) {
        Ok(content) => {
            if let Some((count, reason)) = &content.damaged {
                fs::copy(path, &copy).with_context(named)?;
                say(format_args!(
                    "{}: {} cannot be used ({reason}), done again; the damaged file is {}",
                    path.display(),
                    counted(*count, "line"),
                    copy.display()
                ));
            }
            if content.damaged.is_some() || content.is_torn {
                lines::write(path, &content.header, &content.results)?;
            }
            Ok(content.results)
        }
        Err(error) if error.downcast_ref::<io::Error>().is_some() => Err(error).with_context(named),
        Err(error) => {
            fs::rename(path, &copy).with_context(named)?;
            say(format_args!(
                "{}: cannot be used ({error:#}), begun again; the old file is {}",
                path.display(),
                copy.display()
            ));
            Ok(BTreeMap::new())
        }
    }
}

/// A free name for a damaged file: an earlier one, which may hold results, is not replaced.
fn damaged_copy(path: &Path) -> PathBuf {
    let first = path.with_extension("jsonl.damaged");
    let mut copy = first.clone();
    let mut number = 2;
    while copy.symlink_metadata().is_ok() {
        copy = first.with_extension(format!("damaged-{number}"));
        number += 1;
    }
    copy
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Opens a part of ten pieces.
    fn open(out: &Path) -> anyhow::Result<ShardWork> {
        let shard = Shard { number: 1, of: 1 };
        let terms = Terms::new("eval", shard);
        ShardWork::open::<String>(out, shard, &terms, (10, "idm"))
    }

    fn file(out: &Path) -> PathBuf {
        out.join(Shard { number: 1, of: 1 }.file_name())
    }

    #[test]
    fn a_byte_that_is_no_text_costs_one_piece_and_every_damaged_file_stays() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path();
        let mut work = open(out).expect("a part");
        for piece in 0..10 {
            let kept = work.keep(piece, &format!("result {piece}"));
            kept.expect("kept");
        }
        drop(work);
        let mut damaged = Vec::new();
        for (name, left) in [("jsonl.damaged", 1), ("jsonl.damaged-2", 2)] {
            let mut bytes = fs::read(file(out)).expect("the part");
            let at = bytes.len() - 9;
            bytes[at] ^= 0x80;
            fs::write(file(out), &bytes).expect("written");
            damaged.push((name, bytes));
            let work = open(out).expect("a part");
            assert_eq!(work.left().len(), left, "{name}");
        }
        for (name, bytes) in damaged {
            let copy = fs::read(file(out).with_extension(name)).expect(name);
            assert!(copy == bytes, "{name}");
        }
    }

    #[test]
    fn a_file_that_cannot_be_read_now_or_is_of_another_version_stays() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path();
        // A folder in its place can be opened and not be read.
        fs::create_dir(file(out)).expect("a folder");
        assert!(open(out).is_err());
        assert!(file(out).is_dir());
        fs::remove_dir(file(out)).expect("removed");
        let text = "{\"vlaps_shard\":2}";
        let sum = crc32c::crc32c(text.as_bytes());
        let line = format!("[\"{sum:08x}\", {text}]\n");
        fs::write(file(out), &line).expect("written");
        let error = open(out).err().expect("refused").to_string();
        assert!(error.contains("has format 2"), "{error}");
        assert_eq!(fs::read_to_string(file(out)).expect("the file"), line);
    }
}
