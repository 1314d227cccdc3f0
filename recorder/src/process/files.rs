//! The files of a recording: a new one each minute, and what follows when the disk refuses.

use std::fs;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use shm_config::Instant;

use super::losses::{Losses, Lost};
use super::policies::Policies;
use super::ring::Label;
use super::storage::{Storage, create};
use crate::origin::LOST;
use crate::write::ChannelId;
use crate::{CONFIGURATION, Channel, Origin, POLICIES, RecordingError, Writer};

/// How long a file is written, ns.
const FILE_NS: u64 = 60_000_000_000;
/// How long a chunk is written, ns: this much is lost when the process is killed.
const CHUNK_NS: u64 = 800_000_000;
/// How long it takes until a disk that refused is tried again, ns.
const RETRY_NS: u64 = 2_000_000_000;

/// Bytes that may be attached at the end of a recording.
const ATTACHED_MAX: u64 = 256 << 20;

/// What every file has beside messages.
#[derive(Debug, Clone, Default)]
pub(super) struct Enclosed {
    /// The configuration as it ran.
    pub(super) configuration: String,
    /// The policy files in use.
    pub(super) policies: Policies,
}

impl Enclosed {
    /// Bytes of all of it.
    pub(super) fn bytes(&self) -> u64 {
        let policies = self.policies.iter().map(|(_, policy)| policy.len() as u64);
        policies.sum::<u64>() + self.configuration.len() as u64
    }

    /// Begins a file of this name and the time. One that the disk refuses is removed, or each
    /// try on a full disk would leave a file.
    pub(super) fn begin(
        &self,
        folder: &Path,
        name: &str,
        origin: &Origin,
    ) -> Result<(PathBuf, Writer), RecordingError> {
        let (path, file) = create(folder, name)?;
        let writer = Writer::new(BufWriter::new(file), origin);
        let begun = writer.and_then(|mut writer| {
            self.attach_to(&mut writer)?;
            writer.flush()?;
            Ok(writer)
        });
        match begun {
            Ok(writer) => Ok((path, writer)),
            Err(error) => {
                let _ = fs::remove_file(&path);
                Err(error)
            }
        }
    }

    fn attach_to(&self, writer: &mut Writer) -> Result<(), RecordingError> {
        let text = self.configuration.as_bytes();
        writer.attach(CONFIGURATION, "application/toml", text)?;
        let mut policies = self.policies.iter();
        policies.try_for_each(|(sha256, policy)| attach_policy(writer, sha256, policy))
    }
}

struct Open {
    writer: Writer,
    ids: Vec<ChannelId>,
    path: PathBuf,
    /// Bytes of its attachments.
    enclosed_bytes: u64,
    since: Instant,
    flushed: Instant,
    /// Whether messages are on the disk.
    has_messages: bool,
    /// Messages since the last flush, by channel: lost if the disk refuses it.
    unflushed: Vec<u64>,
    /// The policy files of which the file has the offers, by SHA-256.
    offered: Vec<String>,
}

/// Writes every message.
pub(super) struct Files {
    storage: Storage,
    origin: Origin,
    channels: Vec<Channel>,
    enclosed: Enclosed,
    open: Option<Open>,
    /// Bytes kept for what is attached at the end.
    end_bytes: u64,
    /// The disk refused; it is tried again at this time.
    refused_until: Option<Instant>,
    losses: Losses,
    /// Messages written.
    pub(super) count: u64,
    /// Bytes of finished files.
    pub(super) bytes: u64,
    /// Files written.
    pub(super) files: u64,
}

impl Files {
    pub(super) fn new(
        storage: Storage,
        origin: Origin,
        channels: Vec<Channel>,
        enclosed: Enclosed,
    ) -> Self {
        Self {
            storage,
            origin,
            channels,
            enclosed,
            open: None,
            end_bytes: 0,
            refused_until: None,
            losses: Losses::default(),
            count: 0,
            bytes: 0,
            files: 0,
        }
    }

    /// The folder of this recording.
    pub(super) fn folder(&self) -> &Path {
        &self.storage.folder
    }

    /// Messages that the disk refused.
    pub(super) fn losses(&self) -> &Losses {
        &self.losses
    }

    /// The file that is open has the message that offers this policy file.
    pub(super) fn note_offer(&mut self, sha256: String) {
        if let Some(open) = &mut self.open {
            open.offered.push(sha256);
        }
    }

    /// The policy files in use now: they are added to the files that follow, and to this one,
    /// unless it has their offer.
    pub(super) fn enclose(&mut self, used: Policies) {
        let known = std::mem::replace(&mut self.enclosed.policies, used);
        let Some(open) = &mut self.open else {
            return;
        };
        for (sha256, policy) in &self.enclosed.policies {
            if known.iter().any(|(known, _)| known == sha256) || open.offered.contains(sha256) {
                continue;
            }
            open.enclosed_bytes += policy.len() as u64;
            if let Err(error) = attach_policy(&mut open.writer, sha256, policy) {
                tracing::warn!(%error, "a policy file is not in the recording");
            }
        }
    }

    /// Keeps space for what is attached at the end.
    pub(super) fn reserve_for_attachments(&mut self) {
        self.end_bytes = self.storage.file_bytes_max().min(ATTACHED_MAX);
    }

    /// Bytes that may be attached at the end.
    pub(super) fn attachments_max(&self) -> u64 {
        self.end_bytes
    }

    /// Adds a file of this name and media type to the recording.
    pub(super) fn attach(&mut self, (name, media_type): (&str, &str), data: &[u8], now: Instant) {
        let is_open = self.is_open(now);
        let Some(open) = self.open.as_mut().filter(|_| is_open) else {
            tracing::warn!(
                name,
                "an attachment is not in the recording: the disk refuses it"
            );
            return;
        };
        open.enclosed_bytes += data.len() as u64;
        if let Err(error) = open.writer.attach(name, media_type, data) {
            tracing::warn!(%error, name, "an attachment is not in the recording");
        }
    }

    /// Writes a message, or counts it as lost.
    pub(super) fn take(&mut self, label: Label, cdr: &[u8], now: Instant) {
        if !self.is_open(now) {
            self.losses
                .add(&self.channels[label.channel].service, Lost::Disk, 1);
            return;
        }
        let Some(open) = &mut self.open else {
            return;
        };
        open.unflushed[label.channel] += 1;
        self.count += 1;
        let id = open.ids[label.channel];
        if let Err(error) = open.writer.write_cdr(id, label.stamp, cdr) {
            self.refuse(&error, now);
        }
    }

    /// Completes the chunk or the file when it is due. Call it often. `before_disk` gives the
    /// messages that were lost on the way here.
    pub(super) fn advance(&mut self, now: Instant, before_disk: impl Fn() -> Losses) {
        let Some(open) = &mut self.open else {
            return;
        };
        if now.since_ns(open.flushed) >= CHUNK_NS {
            open.flushed = now;
            match open.writer.flush() {
                Ok(()) => {
                    open.has_messages |= open.unflushed.iter().any(|count| *count > 0);
                    open.unflushed.fill(0);
                }
                Err(error) => return self.refuse(&error, now),
            }
        }
        let Some(open) = &self.open else {
            return;
        };
        let is_old = now.since_ns(open.since) >= FILE_NS;
        let bytes_max = self.storage.file_bytes_max() + open.enclosed_bytes;
        if is_old || self.open_bytes() >= bytes_max {
            self.finish(now, before_disk());
        }
    }

    /// Completes the file that is open; it says which messages were lost until now.
    pub(super) fn finish(&mut self, now: Instant, mut lost: Losses) {
        let Some(mut open) = self.open.take() else {
            return;
        };
        let (path, has_messages) = (open.path.clone(), open.has_messages);
        lost.merge(&self.losses);
        let noted = match lost.is_empty() {
            true => Ok(()),
            false => open.writer.note(LOST, lost.facts()),
        };
        match noted.and_then(|()| open.writer.finish()) {
            Ok(_) => {
                self.files += 1;
                self.bytes += fs::metadata(&path).map_or(0, |metadata| metadata.len());
            }
            Err(error) => {
                self.count_refused(&open.unflushed);
                self.refuse(&error, now);
                if !has_messages {
                    let _ = fs::remove_file(&path);
                }
            }
        }
    }

    /// Bytes of the file that is open, as far as they are written.
    pub(super) fn open_bytes(&self) -> u64 {
        let path = self.open.as_ref().map(|open| &open.path);
        let metadata = path.and_then(|path| fs::metadata(path).ok());
        metadata.map_or(0, |metadata| metadata.len())
    }

    /// Whether a file is open; opens one when that is due.
    fn is_open(&mut self, now: Instant) -> bool {
        if self.open.is_some() {
            return true;
        }
        if self.refused_until.is_some_and(|until| now < until) {
            return false;
        }
        let bytes = self.storage.file_bytes_max() + self.enclosed.bytes() + self.end_bytes;
        self.storage.free_space(&self.origin.run, bytes);
        match self.begin(now) {
            Ok(open) => {
                if self.refused_until.take().is_some() {
                    tracing::warn!(lost = %self.losses, "the disk takes the recording again");
                }
                self.open = Some(open);
                true
            }
            Err(error) => {
                self.refuse(&error, now);
                false
            }
        }
    }

    fn begin(&self, now: Instant) -> Result<Open, RecordingError> {
        let (path, mut writer) =
            self.enclosed
                .begin(&self.storage.folder, &self.origin.run, &self.origin)?;
        let ids = self.channels.iter().map(|channel| writer.channel(channel));
        let ids = ids.collect::<Result<_, _>>()?;
        Ok(Open {
            writer,
            ids,
            path,
            enclosed_bytes: self.enclosed.bytes(),
            since: now,
            flushed: now,
            has_messages: false,
            unflushed: vec![0; self.channels.len()],
            offered: Vec::new(),
        })
    }

    /// The disk refused: what it did not take is lost, and it is tried again later.
    fn refuse(&mut self, error: &RecordingError, now: Instant) {
        if self.refused_until.is_none() {
            let folder = self.storage.folder.display();
            tracing::warn!(
                "{folder}: the disk refuses the recording: {error}; messages are lost and counted \
                 until it takes them again; free some space or lower record.max_mb"
            );
        }
        self.refused_until = Some(now.after_ns(RETRY_NS));
        if let Some(open) = self.open.take() {
            self.count_refused(&open.unflushed);
            self.drop_file(open);
        }
    }

    /// Gives up a file that the disk refuses. It stays when messages of it are on the disk.
    fn drop_file(&self, open: Open) {
        let Open {
            writer,
            path,
            has_messages,
            ..
        } = open;
        // Its end is written, as far as the disk takes it.
        drop(writer);
        if !has_messages {
            let _ = fs::remove_file(&path);
        }
    }

    /// Counts messages that were taken and did not reach the disk, by channel.
    fn count_refused(&mut self, counts: &[u64]) {
        for (channel, count) in self.channels.iter().zip(counts) {
            self.losses.add(&channel.service, Lost::Disk, *count);
            self.count = self.count.saturating_sub(*count);
        }
    }
}

fn attach_policy(writer: &mut Writer, sha256: &str, policy: &[u8]) -> Result<(), RecordingError> {
    let name = format!("{POLICIES}{sha256}");
    writer.attach(&name, "application/octet-stream", policy)
}

#[cfg(test)]
mod tests;
