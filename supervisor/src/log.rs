//! A process's log file.
//!
//! The child writes its lines straight into the file, opened for appending. A
//! pipe through the supervisor would block the child when the supervisor is
//! stopped, and kill it when the supervisor dies. So a full file is rotated by
//! copying it aside and cutting it to nothing: appending goes on at its new end.
//! Lines written between copy and cut are lost, a few milliseconds of one
//! process every `supervisor.log_mb`.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Bytes of a log's end in which its last line is looked for.
const TAIL_BYTES: u64 = 4096;

/// One process's log file, and one older one beside it.
#[derive(Debug)]
pub struct LogFile {
    path: PathBuf,
    limit_bytes: u64,
    mark: u64,
}

impl LogFile {
    /// The log of `name` in `dir`; an earlier run's is set aside.
    ///
    /// # Errors
    /// When the file cannot be moved or made.
    pub fn create(dir: &Path, name: &str, limit_bytes: u64) -> io::Result<Self> {
        let log = Self {
            path: dir.join(format!("{name}.log")),
            limit_bytes,
            mark: 0,
        };
        match fs::rename(&log.path, log.older()) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        log.open()?;
        Ok(log)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file before the last rotation.
    pub fn older(&self) -> PathBuf {
        self.path.with_extension("log.1")
    }

    fn open(&self) -> io::Result<File> {
        OpenOptions::new()
            .append(true)
            .create(true)
            .open(&self.path)
    }

    /// A handle for a new process; [`LogFile::last_line`] looks at its lines only.
    ///
    /// # Errors
    /// When the file cannot be opened.
    pub fn begin(&mut self) -> io::Result<File> {
        let file = self.open()?;
        self.mark = file.metadata()?.len();
        Ok(file)
    }

    /// Sets the file's content aside when there is too much of it.
    ///
    /// # Errors
    /// When it cannot be copied or cut; nothing is lost then.
    pub fn rotate(&mut self) -> io::Result<()> {
        match fs::metadata(&self.path) {
            Ok(metadata) if metadata.len() > self.limit_bytes => {}
            _ => return Ok(()),
        }
        fs::copy(&self.path, self.older())?;
        OpenOptions::new()
            .write(true)
            .open(&self.path)?
            .set_len(0)?;
        self.mark = 0;
        Ok(())
    }

    /// The last line that the newest process wrote; `None` when it wrote none.
    pub fn last_line(&self) -> Option<String> {
        let mut file = File::open(&self.path).ok()?;
        let end = file.metadata().ok()?.len();
        let start = end.saturating_sub(TAIL_BYTES).max(self.mark.min(end));
        file.seek(SeekFrom::Start(start)).ok()?;
        let mut tail = Vec::new();
        file.take(TAIL_BYTES).read_to_end(&mut tail).ok()?;
        let tail = String::from_utf8_lossy(&tail);
        let line = tail.lines().map(str::trim).rfind(|line| !line.is_empty())?;
        // A log line is foreign text: control codes stay off the terminal.
        Some(line.chars().filter(|c| !c.is_control()).collect())
    }
}
