//! The folder of records: written while the gate runs, read by the audit.
//!
//! ```text
//! DIR/questions.jsonl       one line for each question
//! DIR/questions-before.jsonl  the lines before those, after one rotation
//! DIR/pictures/000123-a.png   the picture of the first asking; -b: the second
//! ```
//!
//! A line is appended with one write; a reader skips an incomplete last line. The
//! folder holds at most a fixed number of bytes: half of them for the lines, in two
//! files of which the older is replaced, and the rest for pictures, of which the oldest
//! are deleted. Once the folder is open, nothing here fails: what cannot be written is
//! counted.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use shm_config::file::{Access, Durable, Entry, Folder, make_folders};
use shm_config::text::printable_json;

use super::{Record, VERSION};
use crate::presentation::picture::Picture;

/// The file of lines.
pub const QUESTIONS: &str = "questions.jsonl";
/// The file of the lines before those, after one rotation.
pub const QUESTIONS_BEFORE: &str = "questions-before.jsonl";
/// The folder of pictures.
pub const PICTURES: &str = "pictures";
/// Questions that may wait for their aftermath: those of a minute at four a second.
/// When there are more, the oldest is written unfinished.
const OPEN_MAX: usize = 256;
/// Longest line, bytes; a longer one is not a record.
const LINE_BYTES_MAX: usize = 1 << 20;

/// What could not be stored.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Lost {
    /// Lines.
    pub lines: u64,
    /// Pictures that could not be written; deleted ones do not count.
    pub pictures: u64,
    /// The last reason.
    pub reason: String,
}

/// The folder that records are written to.
#[derive(Debug)]
pub struct Store {
    folder: Folder,
    lines: File,
    line_bytes: u64,
    before_bytes: u64,
    /// Names and sizes, the oldest first.
    pictures: VecDeque<(String, u64)>,
    picture_bytes: u64,
    bytes_max: u64,
    open: VecDeque<Record>,
    last_question: u64,
    lost: Lost,
}

impl Store {
    /// Opens a folder, creates it if necessary, and continues after its last record.
    /// The folder grows to `bytes_max` at most.
    ///
    /// # Errors
    /// When the folder cannot be made or its files not opened.
    pub fn open(folder: &Path, bytes_max: u64) -> Result<Self, StoreError> {
        let failed = |path: &Path| {
            let path = path.to_path_buf();
            move |source| StoreError { path, source }
        };
        let opened = make_folders(folder).and_then(|()| Folder::open(folder, Entry::Readable));
        let ours = opened.map_err(failed(folder))?;
        let pictures_folder = folder.join(PICTURES);
        let made = ours.make_inside(PICTURES, Entry::Readable);
        made.map_err(failed(&pictures_folder))?;
        let path = folder.join(QUESTIONS);
        let opened = ours.open_file(QUESTIONS, Access::Append);
        let mut lines = opened.map_err(failed(&path))?;
        let line_bytes = drop_torn_line(&mut lines).map_err(failed(&path))?;
        let pictures = pictures_in(&pictures_folder).map_err(failed(&pictures_folder))?;
        let before = fs::metadata(folder.join(QUESTIONS_BEFORE));
        // Lines that cannot be read do not stop a run, and no picture of theirs is
        // overwritten.
        let written = read(folder).map_or_else(|_| Vec::new(), |records| records.questions);
        let numbers = written.iter().map(|record| record.question);
        let shown = pictures
            .iter()
            .filter_map(|(name, _)| name.split('-').next()?.parse().ok());
        let last_question = numbers.chain(shown).max().unwrap_or(0);
        Ok(Self {
            folder: ours,
            lines,
            line_bytes,
            before_bytes: before.map_or(0, |data| data.len()),
            picture_bytes: pictures.iter().map(|(_, bytes)| bytes).sum(),
            pictures,
            bytes_max,
            open: VecDeque::new(),
            last_question,
            lost: Lost::default(),
        })
    }

    /// Takes a record with the pictures of its askings, in their order, gives it the
    /// next number, and returns the number. The pictures are then on disk; the line
    /// waits for [`Store::complete`].
    pub fn begin(&mut self, mut record: Record, pictures: &[Picture]) -> u64 {
        self.last_question += 1;
        record.version = VERSION;
        record.question = self.last_question;
        let both = record.askings.iter_mut().zip(pictures);
        for ((asking, picture), letter) in both.zip('a'..) {
            let ending = picture.encoding.extension();
            let name = format!("{:06}-{letter}.{ending}", record.question);
            asking.picture = self.keep_picture(name, &picture.bytes).unwrap_or_default();
        }
        if self.open.len() == OPEN_MAX
            && let Some(oldest) = self.open.pop_front()
        {
            self.write(&oldest);
        }
        self.open.push_back(record);
        self.last_question
    }

    /// The record of a question whose line is not written yet, to be completed.
    pub fn record(&mut self, question: u64) -> Option<&mut Record> {
        self.open
            .iter_mut()
            .find(|record| record.question == question)
    }

    /// Writes the line of a question that is complete.
    pub fn complete(&mut self, question: u64) {
        let at = self
            .open
            .iter()
            .position(|record| record.question == question);
        if let Some(record) = at.and_then(|at| self.open.remove(at)) {
            self.write(&record);
        }
    }

    /// Writes all waiting lines, because the run is over.
    pub fn finish(&mut self) {
        while let Some(record) = self.open.pop_front() {
            self.write(&record);
        }
    }

    /// What could not be stored so far.
    pub fn lost(&self) -> &Lost {
        &self.lost
    }

    /// Bytes of all lines and pictures in the folder.
    pub fn bytes(&self) -> u64 {
        self.line_bytes + self.before_bytes + self.picture_bytes
    }

    fn keep_picture(&mut self, name: String, bytes: &[u8]) -> Option<String> {
        let size = bytes.len() as u64;
        self.make_room(size);
        let kept = format!("{PICTURES}/{name}");
        if self.bytes() + size > self.bytes_max {
            self.lose_picture(format!("{size} bytes do not fit into the folder's bound"));
            return None;
        }
        let pictures = self.folder.inside(PICTURES, Entry::Readable);
        // An incomplete picture is removed.
        let written = pictures.and_then(|pictures| pictures.replace(&name, bytes, Durable::No));
        if let Err(error) = written {
            let path = self.folder.path().join(&kept);
            self.lose_picture(format!("{}: {error}", path.display()));
            return None;
        }
        self.picture_bytes += size;
        self.pictures.push_back((name, size));
        Some(kept)
    }

    /// Deletes the oldest pictures until this many bytes fit.
    fn make_room(&mut self, size: u64) {
        while self.bytes() + size > self.bytes_max {
            let Some((name, bytes)) = self.pictures.pop_front() else {
                return;
            };
            let pictures = self.folder.inside(PICTURES, Entry::Readable);
            match pictures.and_then(|pictures| pictures.remove(&name)) {
                Ok(()) => {}
                Err(error) if error.kind() == ErrorKind::NotFound => {}
                Err(error) => {
                    let path = self.folder.path().join(PICTURES).join(name);
                    self.lost.reason = format!("{}: {error}", path.display());
                }
            }
            self.picture_bytes = self.picture_bytes.saturating_sub(bytes);
        }
    }

    fn write(&mut self, record: &Record) {
        let line = serde_json::to_string(record).unwrap_or_default();
        let mut line = printable_json(&line).into_owned().into_bytes();
        // JSON has no NaN: a line written for one could not be read again.
        if serde_json::from_slice::<Record>(&line).is_err() {
            return self.lose_line("a number that JSON cannot hold".into());
        }
        line.push(b'\n');
        let size = line.len() as u64;
        if self.line_bytes + size > self.bytes_max / 4 {
            self.rotate();
        }
        if size > self.bytes_max / 4 {
            return self.lose_line(format!("{size} bytes do not fit into the folder's bound"));
        }
        self.make_room(size);
        match self.lines.write(&line) {
            Ok(written) if written == line.len() => self.line_bytes += size,
            outcome => {
                let reason = match outcome {
                    Ok(_) => "the disk is full".into(),
                    Err(error) => error.to_string(),
                };
                // An incomplete line must not stand before the next one. A file that is
                // not regular cannot be cut.
                let _ = self.lines.set_len(self.line_bytes);
                self.lose_line(reason);
            }
        }
    }

    /// Moves the lines to the older file, which is replaced.
    fn rotate(&mut self) {
        let renamed = self.folder.rename(QUESTIONS, QUESTIONS_BEFORE);
        let opened = renamed.and_then(|()| self.folder.open_file(QUESTIONS, Access::New));
        match opened {
            Ok(file) => {
                self.lines = file;
                self.before_bytes = self.line_bytes;
                self.line_bytes = 0;
            }
            Err(error) => {
                let path = self.folder.path().join(QUESTIONS);
                self.lost.reason = format!("{}: {error}", path.display());
            }
        }
    }

    fn lose_line(&mut self, reason: String) {
        self.lost.lines += 1;
        self.lost.reason = format!("{}: {reason}", self.folder.path().join(QUESTIONS).display());
    }

    fn lose_picture(&mut self, reason: String) {
        self.lost.pictures += 1;
        self.lost.reason = reason;
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        self.finish();
    }
}

/// The folder of records cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}; the folder of the judge's records must be writable", path.display())]
pub struct StoreError {
    path: PathBuf,
    source: std::io::Error,
}

impl StoreError {
    /// The error about this folder or file.
    pub(crate) fn new(path: &Path, source: std::io::Error) -> Self {
        let path = path.into();
        Self { path, source }
    }
}

/// Cuts off an incomplete last line; returns the remaining length.
fn drop_torn_line(file: &mut File) -> std::io::Result<u64> {
    if !file.metadata()?.is_file() {
        return Ok(0);
    }
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(0))?;
    file.read_to_end(&mut bytes)?;
    let whole = bytes.iter().rposition(|&byte| byte == b'\n');
    let length = whole.map_or(0, |at| at as u64 + 1);
    if length < bytes.len() as u64 {
        file.set_len(length)?;
    }
    Ok(length)
}

/// Names and sizes of the pictures of a folder, the oldest first: a name begins with
/// the number of its question.
fn pictures_in(folder: &Path) -> std::io::Result<VecDeque<(String, u64)>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let data = entry.metadata()?;
        if let Ok(name) = entry.file_name().into_string()
            && data.is_file()
        {
            found.push((name, data.len()));
        }
    }
    found.sort();
    Ok(found.into())
}

/// The records of a folder.
#[derive(Debug, Clone, PartialEq)]
pub struct Records {
    /// The folder they are in; their pictures' names are relative to it.
    pub folder: PathBuf,
    /// The records, in the order in which they were written.
    pub questions: Vec<Record>,
    /// The last line is incomplete and left out: the gate was killed while it wrote.
    pub is_torn: bool,
}

/// Why records cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The folder has no records.
    #[error(
        "{}: no record of a judge here; drive with --gate vlm first, or name a run's folder, \
         such as runs/NAME", folder.display()
    )]
    Nothing {
        /// The folder that was read.
        folder: PathBuf,
    },
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// A line is not a record.
    #[error("{}, line {line}: {reason}; delete the line to read the rest", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
}

/// Reads the records of a run's folder or of the `judge` folder in it.
///
/// # Errors
/// When there are none, a file cannot be read, or a line is not a record. An incomplete
/// last line is no error.
pub fn read(folder: &Path) -> Result<Records, ReadError> {
    let inner = folder.join("judge");
    let holds =
        |folder: &Path| folder.join(QUESTIONS).is_file() || folder.join(QUESTIONS_BEFORE).is_file();
    let folder = match holds(&inner) && !holds(folder) {
        true => inner,
        false => folder.into(),
    };
    let mut records = Records {
        questions: Vec::new(),
        is_torn: false,
        folder,
    };
    for name in [QUESTIONS_BEFORE, QUESTIONS] {
        let path = records.folder.join(name);
        if path.is_file() {
            let bytes = fs::read(&path).map_err(|source| ReadError::Unreadable {
                path: path.clone(),
                source,
            })?;
            records.is_torn = read_lines(&path, &bytes, &mut records.questions)?;
        }
    }
    if records.questions.is_empty() {
        return Err(ReadError::Nothing {
            folder: records.folder,
        });
    }
    Ok(records)
}

/// Appends the records of a file; returns whether its last line is incomplete.
fn read_lines(path: &Path, bytes: &[u8], records: &mut Vec<Record>) -> Result<bool, ReadError> {
    for (index, line) in bytes.split_inclusive(|&byte| byte == b'\n').enumerate() {
        let wrong = |reason: String| ReadError::Line {
            path: path.into(),
            line: index + 1,
            reason,
        };
        let Some(line) = line.strip_suffix(b"\n") else {
            return Ok(true);
        };
        if line.len() > LINE_BYTES_MAX {
            return Err(wrong(format!(
                "{} bytes are too long for a record",
                line.len()
            )));
        }
        let version = serde_json::from_slice::<Version>(line)
            .map_err(|error| wrong(error.to_string()))?
            .version;
        if version > VERSION {
            return Err(wrong(format!(
                "format {version}, this program knows {VERSION}"
            )));
        }
        let record = serde_json::from_slice(line).map_err(|error| wrong(error.to_string()))?;
        records.push(record);
    }
    Ok(false)
}

/// The fields that every version of the format has.
#[derive(serde::Deserialize)]
struct Version {
    version: u32,
}
