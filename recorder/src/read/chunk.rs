//! The messages of one chunk.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::io::Read as _;
use std::path::Path;
use std::sync::Arc;

use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::Entry;
use super::index::{self, RecordSpan};
use crate::channel::{LAYOUT_KEY, MADE_FROM_KEY, SERVICE_KEY};
use crate::{Channel, RecordingError};

/// Bytes of the largest chunk that is read, before compression. The recorder's have 4 MB,
/// and a message of 8 MB.
const CHUNK_MAX: u64 = 256 << 20;

/// One chunk of a file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chunk {
    pub(super) place: RecordSpan,
    /// Log time of its first message, epoch ns; 0 when it has none.
    pub(super) first_ns: u64,
    /// Log time of its last message, epoch ns.
    pub(super) last_ns: u64,
}

/// Calls `each` with every record of a chunk; the checksum is checked at its end.
fn records(
    path: &Path,
    chunk: Chunk,
    mut each: impl FnMut(Record<'_>) -> Result<(), String>,
) -> Result<(), RecordingError> {
    let damaged = |what: String| RecordingError::Damaged {
        path: path.into(),
        part: "the chunk",
        offset: chunk.place.offset - 9,
        what,
    };
    let body = index::read(path, chunk.place, CHUNK_MAX)?;
    let record = mcap::parse_record(op::CHUNK, &body);
    let Record::Chunk { header, .. } = record.map_err(|error| damaged(error.to_string()))? else {
        return Err(damaged("it is no chunk".into()));
    };
    if header.uncompressed_size > CHUNK_MAX {
        let size = header.uncompressed_size;
        return Err(damaged(format!("{size} bytes are more than {CHUNK_MAX}")));
    }
    let mut head = [op::CHUNK; 9];
    head[1..].copy_from_slice(&(body.len() as u64).to_le_bytes());
    let mut source = head.chain(&body[..]);
    // The checksum comes first: the lengths in a damaged chunk may be anything.
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(CHUNK_MAX as usize);
    let mut reader = LinearReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event.map_err(|error| damaged(error.to_string()))? {
            LinearReadEvent::ReadRequest(bytes) => {
                let read = source.read(reader.insert(bytes));
                reader.notify_read(read.map_err(|error| damaged(error.to_string()))?);
            }
            LinearReadEvent::Record { data, opcode } => {
                let record = mcap::parse_record(opcode, data);
                each(record.map_err(|error| damaged(error.to_string()))?).map_err(damaged)?;
            }
        }
    }
    Ok(())
}

/// Collects channels, each with its schema.
#[derive(Debug, Default)]
pub(super) struct Known {
    schemas: HashMap<u16, (String, String)>,
    pub(super) channels: BTreeMap<u16, Arc<Channel>>,
    /// Channels for viewers alone, which hold nothing that the others do not.
    pub(super) made: HashSet<u16>,
}

impl Known {
    fn schema(&mut self, id: u16, name: String, data: &[u8]) {
        let definition = String::from_utf8_lossy(data).into_owned();
        self.schemas.insert(id, (name, definition));
    }

    fn channel(&mut self, channel: mcap::records::Channel) {
        if channel.metadata.contains_key(MADE_FROM_KEY) {
            self.made.insert(channel.id);
            return;
        }
        let schema = self.schemas.get(&channel.schema_id).cloned();
        let (schema, definition) = schema.unwrap_or_default();
        let fact = |key: &str| channel.metadata.get(key).cloned();
        let topic = channel.topic.trim_start_matches('/');
        let known = Channel {
            service: fact(SERVICE_KEY).unwrap_or_else(|| topic.into()),
            schema,
            definition,
            layout: fact(LAYOUT_KEY).unwrap_or_default(),
        };
        self.channels.insert(channel.id, Arc::new(known));
    }

    /// Notes a schema or a channel.
    pub(super) fn note(&mut self, record: Record<'_>) {
        match record {
            Record::Schema { header, data } => self.schema(header.id, header.name, &data),
            Record::Channel(channel) => self.channel(channel),
            _ => {}
        }
    }
}

/// Collects the channels that a chunk declares; returns how many messages it has.
pub(super) fn channels(
    path: &Path,
    chunk: Chunk,
    known: &mut Known,
) -> Result<usize, RecordingError> {
    let mut messages = 0;
    records(path, chunk, |record| {
        messages += usize::from(matches!(record, Record::Message { .. }));
        known.note(record);
        Ok(())
    })?;
    Ok(messages)
}

/// The messages of a chunk in order of the file, of the channels that `wanted` names.
pub(super) fn entries(
    path: &Path,
    chunk: Chunk,
    (channels, made): (&BTreeMap<u16, Arc<Channel>>, &HashSet<u16>),
    wanted: impl Fn(&Channel) -> bool,
) -> Result<Vec<Entry>, RecordingError> {
    let mut later = Known::default();
    let mut entries = Vec::new();
    records(path, chunk, |record| {
        let (header, data) = match record {
            Record::Message { header, data } => (header, data),
            other => {
                later.note(other);
                return Ok(());
            }
        };
        let id = header.channel_id;
        if made.contains(&id) || later.made.contains(&id) {
            return Ok(());
        }
        let channel = channels.get(&id);
        let channel = channel.or_else(|| later.channels.get(&id));
        let channel = channel.ok_or_else(|| format!("a message of the unknown channel {id}"))?;
        if !(chunk.first_ns..=chunk.last_ns).contains(&header.log_time) {
            let log_time = header.log_time;
            return Err(format!(
                "a message of {log_time} ns is outside of the chunk's times"
            ));
        }
        if wanted(channel) {
            entries.push(Entry::new(channel.clone(), &header, data.into_owned()));
        }
        Ok(())
    })?;
    Ok(entries)
}
