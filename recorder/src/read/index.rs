//! What a file has and where, found by walking over its records.
//!
//! The walk reads the lengths and the beginnings of the records, not the messages. It needs
//! no index at the end of the file, so a file whose recorder was killed is read like others.

use std::collections::{BTreeMap, HashSet};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::MAGIC;
use mcap::records::{Record, op};

use super::checksum::Ends;
use super::chunk::{self, Chunk, Known};
use super::count::{self, Indexed};
use crate::origin::{LOST, METADATA};
use crate::{Channel, FORMAT, Origin, RecordingError};

/// Bytes of an opcode and a length.
const RECORD_HEAD: u64 = 9;
/// Bytes of the largest metadata record that is read.
const METADATA_MAX: u64 = 1 << 20;
/// Bytes of an attachment's record before its data that are read: two times, two names and
/// the length.
const ATTACHMENT_HEAD: u64 = 4096;

/// A record of a file.
#[derive(Debug, Clone, Copy)]
pub(super) struct RecordSpan {
    /// First byte of its body.
    pub(super) offset: u64,
    /// Bytes of its body.
    pub(super) length: u64,
}

/// A file added to a recording.
#[derive(Debug, Clone)]
pub struct Attachment {
    /// Its name, such as `config.toml` or `policy/<SHA-256>`.
    pub name: String,
    /// Its media type.
    pub media_type: String,
    /// Bytes of its data.
    pub bytes: u64,
    pub(super) place: RecordSpan,
    pub(super) file: usize,
}

/// One file.
#[derive(Debug)]
pub(super) struct FileIndex {
    pub(super) path: PathBuf,
    pub(super) origin: Origin,
    pub(super) chunks: Vec<Chunk>,
    pub(super) attachments: Vec<Attachment>,
    pub(super) channels: BTreeMap<u16, Arc<Channel>>,
    /// Channels for viewers alone.
    pub(super) made: HashSet<u16>,
    /// Messages that were lost until its end, by service and place.
    pub(super) lost: BTreeMap<String, String>,
    pub(super) ends: Ends,
    /// For each chunk, what its message indexes count.
    pub(super) indexed: Vec<Vec<Indexed>>,
    /// One line when the end of the file is missing or damaged.
    pub(super) damage: Option<String>,
}

impl FileIndex {
    /// Walks over a file.
    pub(super) fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut walk = Walk::open(path)?;
        let damage = walk.walk(Until::End)?;
        let origin = walk.take_origin(damage.is_some())?;
        // The recorder writes the channels at the beginning of a file; the index at its end
        // has those that came later too.
        let mut chunks = Vec::with_capacity(walk.chunks.len());
        let mut indexed = Vec::with_capacity(walk.chunks.len());
        for (number, chunk) in walk.chunks.iter().enumerate() {
            // Without a message its times are 0.
            let may_be_empty = chunk.last_ns == 0;
            let has_messages = match number == 0 || may_be_empty {
                true => chunk::channels(path, *chunk, &mut walk.known)? > 0,
                false => true,
            };
            if has_messages {
                chunks.push(*chunk);
                indexed.push(std::mem::take(&mut walk.indexed[number]));
            }
        }
        Ok(Self {
            path: path.into(),
            origin,
            chunks,
            indexed,
            attachments: walk.attachments,
            channels: walk.known.channels,
            made: walk.known.made,
            lost: walk.lost,
            ends: walk.ends,
            damage,
        })
    }
}

/// The origin that a file's metadata names. Only the beginning of the file is read.
///
/// # Errors
/// As [`FileIndex::open`].
#[cfg(feature = "process")]
pub(crate) fn origin_of(path: &Path) -> Result<Origin, RecordingError> {
    let mut walk = Walk::open(path)?;
    let damage = walk.walk(Until::Origin)?;
    walk.take_origin(damage.is_some())
}

/// How far a walk goes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Until {
    /// To the metadata with the origin.
    #[cfg(feature = "process")]
    Origin,
    /// To the end of the data.
    End,
}

struct Walk<'a> {
    file: BufReader<File>,
    path: &'a Path,
    length: u64,
    origin: Option<Origin>,
    chunks: Vec<Chunk>,
    indexed: Vec<Vec<Indexed>>,
    attachments: Vec<Attachment>,
    known: Known,
    lost: BTreeMap<String, String>,
    ends: Ends,
}

impl<'a> Walk<'a> {
    /// Opens a file, and reads that it is one of MCAP.
    fn open(path: &'a Path) -> Result<Self, RecordingError> {
        let io = |error| RecordingError::io(path)(error);
        let file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let walk = Self {
            file: BufReader::with_capacity(4096, file),
            path,
            length,
            origin: None,
            chunks: Vec::new(),
            indexed: Vec::new(),
            attachments: Vec::new(),
            known: Known::default(),
            lost: BTreeMap::new(),
            ends: Ends::default(),
        };
        walk.after_magic()
    }

    fn after_magic(mut self) -> Result<Self, RecordingError> {
        let mut magic = [0; 8];
        if self.length < magic.len() as u64 {
            return Err(self.unbegun());
        }
        let read = self.file.read_exact(&mut magic);
        read.map_err(RecordingError::io(self.path))?;
        match magic == *MAGIC {
            true => Ok(self),
            false => Err(self.foreign("it is no MCAP file")),
        }
    }

    /// The origin, where the walk has met it.
    fn take_origin(&mut self, is_cut: bool) -> Result<Origin, RecordingError> {
        match (self.origin.take(), is_cut) {
            (Some(origin), _) => Ok(origin),
            (None, true) => Err(self.unbegun()),
            (None, false) => Err(self.foreign(&format!("it has no metadata '{METADATA}'"))),
        }
    }

    fn unbegun(&self) -> RecordingError {
        RecordingError::Unbegun {
            path: self.path.into(),
            bytes: self.length,
        }
    }

    fn foreign(&self, what: &str) -> RecordingError {
        RecordingError::Foreign {
            path: self.path.into(),
            what: what.into(),
        }
    }

    /// Walks to the end of the data, or until the origin is known; returns one line when the
    /// file ends before it.
    fn walk(&mut self, until: Until) -> Result<Option<String>, RecordingError> {
        let mut at = MAGIC.len() as u64;
        loop {
            let cut = |what: &str| {
                let path = self.path.display();
                Ok(Some(format!(
                    "{path}: ends at byte {} within {what}; its recorder was stopped, and the \
                     messages before byte {at} are read",
                    self.length
                )))
            };
            if at == self.length {
                return cut("the data");
            }
            if at + RECORD_HEAD > self.length {
                return cut("the head of a record");
            }
            let mut head = [0; RECORD_HEAD as usize];
            self.file
                .read_exact(&mut head)
                .map_err(RecordingError::io(self.path))?;
            let [opcode, length @ ..] = head;
            let place = RecordSpan {
                offset: at + RECORD_HEAD,
                length: u64::from_le_bytes(length),
            };
            if place.length > self.length - place.offset {
                return cut(match opcode {
                    op::CHUNK => "a chunk",
                    op::ATTACHMENT => "an attachment",
                    _ => "a record",
                });
            }
            self.note(opcode, place)?;
            if opcode == op::FOOTER {
                return Ok(None);
            }
            if until != Until::End && self.origin.is_some() {
                return Ok(None);
            }
            at = place.offset + place.length;
            // Within the buffer this costs no system call.
            let from = self
                .file
                .stream_position()
                .map_err(RecordingError::io(self.path))?;
            let ahead = at as i64 - from as i64;
            self.file
                .seek_relative(ahead)
                .map_err(RecordingError::io(self.path))?;
        }
    }

    fn note(&mut self, opcode: u8, place: RecordSpan) -> Result<(), RecordingError> {
        match opcode {
            op::CHUNK => {
                let body = self.body(place, 16)?;
                let time = |at: usize| {
                    let bytes = body.get(at..at + 8).and_then(|bytes| bytes.try_into().ok());
                    bytes.map(u64::from_le_bytes)
                };
                let (Some(first_ns), Some(last_ns)) = (time(0), time(8)) else {
                    return Err(self.damaged("a chunk", place, "it is too short"));
                };
                self.chunks.push(Chunk {
                    place,
                    first_ns,
                    last_ns,
                });
                self.indexed.push(Vec::new());
            }
            // They follow their chunk.
            op::MESSAGE_INDEX if place.length <= METADATA_MAX => {
                let body = self.body(place, METADATA_MAX)?;
                if let Some(chunk) = self.indexed.last_mut() {
                    chunk.extend(count::indexed(&body));
                }
            }
            op::SCHEMA | op::CHANNEL if place.length <= METADATA_MAX => {
                let body = self.body(place, METADATA_MAX)?;
                if let Ok(record) = mcap::parse_record(opcode, &body) {
                    self.known.note(record);
                }
            }
            op::METADATA if place.length <= METADATA_MAX => {
                let body = self.body(place, METADATA_MAX)?;
                if let Ok(Record::Metadata(metadata)) = mcap::parse_record(opcode, &body) {
                    match metadata.name.as_str() {
                        METADATA => self.note_origin(metadata.metadata, place)?,
                        LOST => self.lost = metadata.metadata,
                        _ => {}
                    }
                }
            }
            op::ATTACHMENT => {
                let body = self.body(place, ATTACHMENT_HEAD)?;
                let (name, media_type, bytes) = attachment(&body)
                    .ok_or_else(|| self.damaged("an attachment", place, "its head"))?;
                // The recording numbers its files in order of time.
                let file = 0;
                self.attachments.push(Attachment {
                    name,
                    media_type,
                    bytes,
                    place,
                    file,
                });
            }
            op::DATA_END | op::FOOTER => {
                let body = self.body(place, 20)?;
                let begins = place.offset - RECORD_HEAD;
                match mcap::parse_record(opcode, &body) {
                    Ok(Record::DataEnd(end)) => {
                        self.ends.data = Some((begins, end.data_section_crc));
                    }
                    Ok(Record::Footer(end)) => {
                        self.ends.footer = Some((begins, end.summary_start, end.summary_crc));
                    }
                    _ => {}
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn note_origin(
        &mut self,
        facts: BTreeMap<String, String>,
        place: RecordSpan,
    ) -> Result<(), RecordingError> {
        let (format, origin) = Origin::from_metadata(facts)
            .map_err(|key| self.damaged("the metadata", place, &format!("'{key}'")))?;
        if format > FORMAT {
            let path = self.path.into();
            return Err(RecordingError::Newer { path, format });
        }
        self.origin = Some(origin);
        Ok(())
    }

    /// The first bytes of a record's body, at most this many.
    fn body(&mut self, place: RecordSpan, max: u64) -> Result<Vec<u8>, RecordingError> {
        let mut body = vec![0; place.length.min(max) as usize];
        let read = self.file.read_exact(&mut body);
        read.map_err(RecordingError::io(self.path))?;
        Ok(body)
    }

    fn damaged(&self, part: &'static str, place: RecordSpan, what: &str) -> RecordingError {
        RecordingError::Damaged {
            path: self.path.into(),
            part,
            offset: place.offset - RECORD_HEAD,
            what: what.into(),
        }
    }
}

/// Name, media type and bytes of an attachment, from the head of its record.
fn attachment(head: &[u8]) -> Option<(String, String, u64)> {
    // Two times come first.
    let mut rest = head.get(16..)?;
    let mut text = || {
        let (length, after) = rest.split_first_chunk()?;
        let (text, after) = after.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        rest = after;
        String::from_utf8(text.to_vec()).ok()
    };
    let (name, media_type) = (text()?, text()?);
    let (bytes, _) = rest.split_first_chunk()?;
    Some((name, media_type, u64::from_le_bytes(*bytes)))
}

/// Reads the whole body of a record, of at most this many bytes.
pub(super) fn read(path: &Path, place: RecordSpan, max: u64) -> Result<Vec<u8>, RecordingError> {
    if place.length > max {
        return Err(RecordingError::Damaged {
            path: path.into(),
            part: "a record",
            offset: place.offset - RECORD_HEAD,
            what: format!("{} bytes are more than {max}", place.length),
        });
    }
    let io = |error| RecordingError::io(path)(error);
    let mut file = File::open(path).map_err(io)?;
    file.seek(SeekFrom::Start(place.offset)).map_err(io)?;
    let mut body = vec![0; place.length as usize];
    file.read_exact(&mut body).map_err(io)?;
    Ok(body)
}
