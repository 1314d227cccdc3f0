//! One file of a recording, written.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::Path;

use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, WriteOptions};
use shm_config::Message;
use shm_config::services::Service;

use crate::channel::{Channel, MESSAGE_ENCODING, SCHEMA_ENCODING};
use crate::origin::METADATA;
use crate::schema::ENCAPSULATION;
use crate::{Origin, RecordingError};

/// Bytes of a chunk before compression: at 1,000 Hz half a second.
const CHUNK_BYTES: u64 = 4 << 20;
/// The level of zstd: the fastest, because the recorder shares the cores with the set.
const LEVEL: u32 = 1;

/// The channel of one file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChannelId(u16);

/// When a message was recorded and taken, and its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Stamp {
    /// When it was recorded, on the run's clock, ns. An earlier time than that of the message
    /// before is raised to it.
    pub recorded_ns: u64,
    /// Its `header.taken_ns`, on the run's clock, ns.
    pub taken_ns: u64,
    /// Its `header.sequence`.
    pub sequence: u64,
}

/// Writes one file. Until [`Writer::finish`] the file has no index; it is read all the same,
/// up to the last [`Writer::flush`].
pub struct Writer<W: Write + Seek = BufWriter<File>> {
    file: mcap::Writer<W>,
    channels: BTreeMap<String, ChannelId>,
    epoch_offset_ns: u64,
    last_ns: u64,
    buffer: Vec<u8>,
}

impl Writer {
    /// Creates the file; an existing one is replaced.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn create(path: &Path, origin: &Origin) -> Result<Self, RecordingError> {
        let file = File::create(path).map_err(RecordingError::io(path))?;
        Self::new(BufWriter::new(file), origin)
    }
}

impl<W: Write + Seek> Writer<W> {
    /// Begins a file with its metadata.
    ///
    /// # Errors
    /// When `out` refuses.
    pub fn new(out: W, origin: &Origin) -> Result<Self, RecordingError> {
        let mut file = WriteOptions::new()
            .profile("ros2")
            .library(concat!("vlaps ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .compression_level(LEVEL)
            // Threads of its own would take the cores of others.
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            // A chunk is written whole, so that a killed file ends with a whole one.
            .disable_seeking(true)
            .create(out)?;
        file.write_metadata(&Metadata {
            name: METADATA.into(),
            metadata: origin.to_metadata(),
        })?;
        let mut writer = Self {
            file,
            channels: BTreeMap::new(),
            epoch_offset_ns: origin.epoch_offset_ns,
            last_ns: 0,
            buffer: Vec::new(),
        };
        // In a chunk of their own: a reader finds them without reading messages.
        for channel in Channel::recorded() {
            writer.channel(&channel)?;
        }
        writer.flush()?;
        Ok(writer)
    }

    /// The channel in this file; it is added when the file does not have it.
    ///
    /// # Errors
    /// When `out` refuses.
    pub fn channel(&mut self, channel: &Channel) -> Result<ChannelId, RecordingError> {
        if let Some(id) = self.channels.get(&channel.service) {
            return Ok(*id);
        }
        let definition = channel.definition.as_bytes();
        let schema = self
            .file
            .add_schema(&channel.schema, SCHEMA_ENCODING, definition)?;
        let (topic, metadata) = (channel.topic(), channel.metadata());
        let id = self
            .file
            .add_channel(schema, &topic, MESSAGE_ENCODING, &metadata)?;
        self.channels.insert(channel.service.clone(), ChannelId(id));
        Ok(ChannelId(id))
    }

    /// Writes a message that is CDR already: [`ENCAPSULATION`] and the struct.
    ///
    /// # Errors
    /// When `out` refuses.
    pub fn write_cdr(
        &mut self,
        channel: ChannelId,
        stamp: Stamp,
        cdr: &[u8],
    ) -> Result<(), RecordingError> {
        self.last_ns = self.last_ns.max(stamp.recorded_ns);
        let header = MessageHeader {
            channel_id: channel.0,
            // MCAP's number has 32 bits; the message has all of them.
            sequence: stamp.sequence as u32,
            log_time: self.last_ns.saturating_add(self.epoch_offset_ns),
            publish_time: stamp.taken_ns,
        };
        Ok(self.file.write_to_known_channel(&header, cdr)?)
    }

    /// Writes a message that was recorded at this time of the run's clock, ns.
    ///
    /// # Errors
    /// When `out` refuses.
    pub fn write<M: Message>(
        &mut self,
        service: &Service<M>,
        recorded_ns: u64,
        message: &M,
    ) -> Result<(), RecordingError> {
        let id = match self.channels.get(service.name) {
            Some(id) => *id,
            None => self.channel(&Channel::of(&service.row, service.name))?,
        };
        let stamp = Stamp {
            recorded_ns,
            taken_ns: message.header().taken_ns,
            sequence: message.header().sequence,
        };
        let mut cdr = std::mem::take(&mut self.buffer);
        cdr.clear();
        cdr.extend_from_slice(&ENCAPSULATION);
        cdr.extend_from_slice(message.as_bytes());
        let written = self.write_cdr(id, stamp, &cdr);
        self.buffer = cdr;
        written
    }

    /// Adds a file to the recording.
    ///
    /// # Errors
    /// When `out` refuses.
    pub fn attach(
        &mut self,
        name: &str,
        media_type: &str,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let now_ns = self.last_ns.saturating_add(self.epoch_offset_ns);
        Ok(self.file.attach(&mcap::Attachment {
            log_time: now_ns,
            create_time: now_ns,
            name: name.into(),
            media_type: media_type.into(),
            data: Cow::Borrowed(data),
        })?)
    }

    /// Adds facts under a name.
    ///
    /// # Errors
    /// When `out` refuses.
    pub fn note(
        &mut self,
        name: &str,
        facts: BTreeMap<String, String>,
    ) -> Result<(), RecordingError> {
        Ok(self.file.write_metadata(&Metadata {
            name: name.into(),
            metadata: facts,
        })?)
    }

    /// Completes the chunk and hands it to the system: what was written until now survives
    /// the death of the process.
    ///
    /// # Errors
    /// When `out` refuses.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        Ok(self.file.flush()?)
    }

    /// Completes the file with its index, and returns what it was written to.
    ///
    /// # Errors
    /// When `out` refuses.
    pub fn finish(mut self) -> Result<W, RecordingError> {
        self.file.finish()?;
        let mut out = self.file.into_inner();
        out.flush()
            .map_err(|error| RecordingError::Write(error.into()))?;
        Ok(out)
    }
}
