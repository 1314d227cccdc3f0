//! One recorded message.

use std::path::Path;
use std::sync::Arc;

use mcap::records::MessageHeader;
use shm_config::Message;
use shm_config::layout::Layout;
use shm_config::message::Header;
use shm_config::services::Service;

use crate::schema::ENCAPSULATION;
use crate::{Channel, Origin, RecordingError};

/// One recorded message: its channel, its times and its bytes.
#[derive(Debug, Clone)]
pub struct Entry {
    /// Its channel.
    pub channel: Arc<Channel>,
    /// When it was recorded, epoch ns; never decreases.
    pub log_ns: u64,
    /// Its `header.taken_ns`: when it was taken, on the run's clock, ns.
    pub taken_ns: u64,
    cdr: Vec<u8>,
}

impl Entry {
    pub(super) fn new(channel: Arc<Channel>, header: &MessageHeader, cdr: Vec<u8>) -> Self {
        Self {
            channel,
            log_ns: header.log_time,
            taken_ns: header.publish_time,
            cdr,
        }
    }

    /// When it was recorded, on the run's clock, ns.
    pub fn recorded_ns(&self, origin: &Origin) -> u64 {
        self.log_ns.saturating_sub(origin.epoch_offset_ns)
    }

    /// The message as ROS 2 CDR.
    pub fn cdr(&self) -> &[u8] {
        &self.cdr
    }

    /// The message's memory; empty when it is shorter than CDR's first four bytes.
    pub fn bytes(&self) -> &[u8] {
        self.cdr.get(ENCAPSULATION.len()..).unwrap_or_default()
    }

    /// The message's header, with which every message begins; `None` when it is shorter.
    pub fn header(&self) -> Option<Header> {
        Header::from_bytes(self.bytes().get(..size_of::<Header>())?)
    }

    /// Whether it is a message of this service.
    pub fn is<M>(&self, service: &Service<M>) -> bool {
        self.channel.service == service.name
    }

    /// The message, if it is of this service and of this binary's layout. For messages of
    /// megabytes use [`Entry::bytes`] with `Layout::copy_from`.
    pub fn read<M: Message>(&self, service: &Service<M>) -> Option<M> {
        (self.is(service) && self.channel.layout == layout::<M>())
            .then(|| M::from_bytes(self.bytes()))
            .flatten()
    }
}

/// The hash of a message's layout as channels have it.
pub(super) fn layout<M: Message>() -> String {
    format!("{:016x}", M::FINGERPRINT)
}

/// The message of an entry of this type's service.
pub(super) fn typed<M: Message>(
    entry: &Entry,
    (path, origin): (&Path, &Origin),
) -> Result<M, RecordingError> {
    let ours = layout::<M>();
    let path = path.to_path_buf();
    if entry.channel.layout != ours {
        return Err(RecordingError::Layout {
            path,
            service: entry.channel.service.clone(),
            theirs: entry.channel.layout.clone(),
            ours,
            commit: origin.fact("commit").into(),
        });
    }
    let bytes = entry.bytes();
    M::from_bytes(bytes).ok_or_else(|| RecordingError::Foreign {
        path,
        what: format!(
            "a message of '{}' has {} bytes in place of {}",
            entry.channel.service,
            bytes.len(),
            size_of::<M>()
        ),
    })
}
