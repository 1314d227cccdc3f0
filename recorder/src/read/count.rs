//! How many messages of each service a recording has, from the message indexes that follow
//! each chunk; a chunk without them is read.

use std::collections::BTreeMap;

use super::chunk;
use super::index::FileIndex;

/// Bytes of an entry: log time and offset.
const ENTRY: usize = 16;

/// The messages of one service.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Count {
    /// How many.
    pub messages: u64,
    /// When the first was recorded, epoch ns.
    pub first_log_ns: u64,
    /// When the last was recorded, epoch ns.
    pub last_log_ns: u64,
}

impl Count {
    fn of(log_ns: u64) -> Self {
        Self {
            messages: 1,
            first_log_ns: log_ns,
            last_log_ns: log_ns,
        }
    }

    fn join(&mut self, other: Self) {
        self.messages += other.messages;
        self.first_log_ns = self.first_log_ns.min(other.first_log_ns);
        self.last_log_ns = self.last_log_ns.max(other.last_log_ns);
    }
}

/// A channel and its messages in one chunk.
pub(super) type Indexed = (u16, Count);

/// What a message index counts; `None` when it has no entry or is cut off.
pub(super) fn indexed(body: &[u8]) -> Option<Indexed> {
    let (channel, rest) = body.split_first_chunk()?;
    let (length, entries) = rest.split_first_chunk()?;
    let entries = entries.get(..u32::from_le_bytes(*length) as usize)?;
    let time = |at: usize| {
        let bytes = entries.get(at..)?.first_chunk()?;
        Some(u64::from_le_bytes(*bytes))
    };
    let messages = entries.len() / ENTRY;
    let count = Count {
        messages: messages as u64,
        first_log_ns: time(0)?,
        // Log times never decrease.
        last_log_ns: time(messages.checked_sub(1)? * ENTRY)?,
    };
    Some((u16::from_le_bytes(*channel), count))
}

/// Counts the messages of a file by service. A chunk that is damaged counts nothing.
pub(super) fn count(file: &FileIndex, into: &mut BTreeMap<String, Count>) {
    let mut add = |service: &str, count: Count| match into.get_mut(service) {
        Some(known) => known.join(count),
        None => {
            into.insert(service.into(), count);
        }
    };
    let last = file.chunks.len().saturating_sub(1);
    for (number, (chunk, indexed)) in file.chunks.iter().zip(&file.indexed).enumerate() {
        // A file that was cut off may have lost a part of its last chunk's indexes.
        let is_whole = !(indexed.is_empty() || (file.damage.is_some() && number == last));
        let known = |(id, _): &Indexed| file.channels.contains_key(id) || file.made.contains(id);
        if is_whole && indexed.iter().all(known) {
            for (id, count) in indexed {
                if let Some(channel) = file.channels.get(id) {
                    add(&channel.service, *count);
                }
            }
            continue;
        }
        let entries = chunk::entries(&file.path, *chunk, (&file.channels, &file.made), |_| true);
        for entry in entries.unwrap_or_default() {
            add(&entry.channel.service, Count::of(entry.log_ns));
        }
    }
}
