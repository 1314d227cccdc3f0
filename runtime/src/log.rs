//! A process's log file.
//!
//! The child appends its lines directly to the file. A pipe through the supervisor would
//! block the child while the supervisor is stopped, and kill it when the supervisor dies.
//! A full file is rotated by copying it and truncating it to zero length; the child then
//! appends at the new end. Lines written between the copy and the truncation are lost: a
//! few milliseconds of one process every `supervisor.log_mb`.
//!
//! The file is opened once, all operations use that descriptor, and the copy is a new
//! file that is renamed to its final name. So no other file in the folder is read,
//! written or truncated.

use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};

use shm_config::file::{Access, Entry, Folder};

/// Bytes at the end of a log that are searched for its last lines: a backtrace of a
/// hundred frames.
const TAIL_BYTES: u64 = 16 << 10;
/// Bytes copied at a time.
const COPY_BYTES: usize = 1 << 16;

/// The log file of one process, with one older file beside it.
#[derive(Debug)]
pub struct LogFile {
    folder: Folder,
    name: String,
    path: PathBuf,
    file: File,
    limit_bytes: u64,
    mark: u64,
}

impl LogFile {
    /// Creates the log of `name` in `dir`; the log of an earlier run is renamed.
    ///
    /// # Errors
    /// When another user may write to the folder, or the file cannot be renamed or created.
    pub fn create(dir: &Path, name: &str, limit_bytes: u64) -> io::Result<Self> {
        let folder = Folder::open(dir, Entry::Readable)?;
        let name = format!("{name}.log");
        match folder.rename(&name, &older(&name)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        Ok(Self {
            path: dir.join(&name),
            file: folder.open_file(&name, Access::New)?,
            folder,
            name,
            limit_bytes,
            mark: 0,
        })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file before the last rotation.
    pub fn older(&self) -> PathBuf {
        self.path.with_file_name(older(&self.name))
    }

    /// A handle for a new process; from now on [`LogFile::last_line`] reads its lines only.
    ///
    /// # Errors
    /// When the system has no descriptor left.
    pub fn begin(&mut self) -> io::Result<File> {
        if self.is_removed()
            && let Ok(file) = self.folder.open_file(&self.name, Access::New)
        {
            // A user deleted it to free space, and expects the next lines there.
            self.file = file;
        }
        self.mark = self.file.metadata()?.len();
        self.file.try_clone()
    }

    fn is_removed(&self) -> bool {
        self.file
            .metadata()
            .is_ok_and(|metadata| metadata.nlink() == 0)
    }

    /// Moves the file's content to the older file when it exceeds its limit.
    ///
    /// # Errors
    /// When it cannot be copied or truncated; no line is lost then.
    pub fn rotate(&mut self) -> io::Result<()> {
        if self.file.metadata()?.len() <= self.limit_bytes {
            return Ok(());
        }
        let aside = format!("{}.new", older(&self.name));
        // A killed supervisor may have left it.
        let _ = self.folder.remove(&aside);
        let copied = self.folder.open_file(&aside, Access::New);
        copied
            .and_then(|file| copy(&self.file, file))
            .and_then(|()| self.folder.rename(&aside, &older(&self.name)))
            .inspect_err(|_| {
                let _ = self.folder.remove(&aside);
            })?;
        self.file.set_len(0)?;
        self.mark = 0;
        Ok(())
    }

    /// The last line written by the newest process; `None` when it wrote none.
    pub fn last_line(&self) -> Option<String> {
        self.last_lines(1).pop()
    }

    /// The last lines written by the newest process, at most `count`, in their order; of
    /// several lines, those from its last panic on, whose backtrace may follow.
    pub fn last_lines(&self, count: usize) -> Vec<String> {
        let mut tail = [0; TAIL_BYTES as usize];
        let read = self.file.metadata().and_then(|metadata| {
            let end = metadata.len();
            let start = end.saturating_sub(TAIL_BYTES).max(self.mark.min(end));
            self.file.read_at(&mut tail, start)
        });
        let tail = String::from_utf8_lossy(tail.get(..read.unwrap_or(0)).unwrap_or_default());
        let lines = tail.lines().map(str::trim).filter(|line| !line.is_empty());
        let lines: Vec<&str> = lines.collect();
        let panic = lines
            .iter()
            .rposition(|line| line.contains(" panicked at "));
        let from = match panic {
            Some(panic) if count > 1 => panic,
            _ => lines.len().saturating_sub(count),
        };
        // A log line is untrusted text: its control characters must not reach the terminal.
        let plain = |line: &&str| line.chars().filter(|c| !c.is_control()).collect();
        lines.iter().skip(from).take(count).map(plain).collect()
    }
}

fn older(name: &str) -> String {
    format!("{name}.1")
}

/// Reads by position: the children write at the descriptor's own offset.
fn copy(from: &File, mut to: File) -> io::Result<()> {
    let mut bytes = vec![0; COPY_BYTES];
    let mut at = 0;
    loop {
        let read = from.read_at(&mut bytes, at)?;
        match bytes.get(..read) {
            Some(read) if !read.is_empty() => to.write_all(read)?,
            _ => return Ok(()),
        }
        at += read as u64;
    }
}
