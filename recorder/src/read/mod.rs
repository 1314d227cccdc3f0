//! A recording, read.

mod checksum;
mod chunk;
mod count;
mod entries;
mod entry;
mod index;
mod offers;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use mcap::records::{Record, op};
use shm_config::Message;
use shm_config::services::Service;

use crate::{CONFIGURATION, Channel, Origin, POLICIES, RecordingError};
pub use count::Count;
pub use entries::{Entries, Messages};
pub use entry::Entry;
pub use index::Attachment;
use index::FileIndex;
#[cfg(feature = "process")]
pub(crate) use index::origin_of;
#[cfg(feature = "process")]
pub(crate) use offers::offered;

/// The ending of a recording's files.
pub(crate) const ENDING: &str = "mcap";

/// Bytes of the largest attachment that is read: more than the recorder attaches.
const ATTACHMENT_MAX: u64 = 1 << 30;

/// A recording: the files of one run in order of time. Clones share its index; a reader
/// holds the messages of one chunk in memory.
#[derive(Debug, Clone)]
pub struct Recording {
    files: Arc<[FileIndex]>,
    /// See [`offers::times`]; all messages of `weights` are read for it, once.
    offers: Arc<OnceLock<BTreeMap<u64, u64>>>,
}

impl Recording {
    /// Opens a folder with the files of one run, or one file. Only the places of the messages
    /// are read.
    ///
    /// A file without its end is no error: [`Recording::damage`] names it.
    ///
    /// # Errors
    /// A path that does not exist, a folder without a file or with the files of several runs,
    /// a foreign file, a newer format.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let paths = match path.is_dir() {
            true => files_of(path)?,
            false => vec![path.to_path_buf()],
        };
        let (mut files, mut unbegun) = (Vec::new(), None);
        for path in &paths {
            match FileIndex::open(path) {
                Ok(file) => files.push(file),
                // A recorder was killed as it began a file; the others are whole.
                Err(error @ RecordingError::Unbegun { .. }) => unbegun = Some(error),
                Err(error) => return Err(error),
            }
        }
        if let (true, Some(error)) = (files.is_empty(), unbegun) {
            return Err(error);
        }
        // Files of one run follow each other; their names need not be in order.
        files.sort_by_key(|file| file.chunks.first().map(|chunk| chunk.first_ns));
        for (number, file) in files.iter_mut().enumerate() {
            file.attachments
                .iter_mut()
                .for_each(|attachment| attachment.file = number);
        }
        let session = |file: &FileIndex| (file.origin.run.clone(), file.origin.session.clone());
        let mut sessions: Vec<_> = files.iter().map(session).collect();
        sessions.sort_unstable();
        sessions.dedup();
        match &files[..] {
            [] => Err(RecordingError::Empty(path.into())),
            [first, ..] if sessions.len() > 1 => Err(RecordingError::Mixed {
                folder: path.into(),
                sessions: sessions.len(),
                example: first.path.clone(),
            }),
            _ => Ok(Self {
                files: files.into(),
                offers: Arc::default(),
            }),
        }
    }

    /// The run that was recorded.
    pub fn origin(&self) -> &Origin {
        // `open` refuses a recording without files.
        &self.files[0].origin
    }

    /// The files in order of time.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(|file| file.path.as_path())
    }

    /// One line for each file that ends before its end: its recorder was killed, or records
    /// still.
    pub fn damage(&self) -> impl Iterator<Item = &str> {
        self.files.iter().filter_map(|file| file.damage.as_deref())
    }

    /// Reads every byte and compares the checksums of the complete files. A chunk or an
    /// attachment is checked when it is read, also in a file whose recorder was stopped.
    ///
    /// # Errors
    /// The first file with a bit that is not the one that was written.
    pub fn verify(&self) -> Result<(), RecordingError> {
        self.files.iter().try_for_each(checksum::verify)
    }

    /// The file in which a message of this time of the run's clock, ns, is looked for first.
    pub fn file_at(&self, run_ns: u64) -> Option<&Path> {
        let at_ns = run_ns.saturating_add(self.origin().epoch_offset_ns);
        let ends = |file: &&FileIndex| file.chunks.last().map_or(0, |chunk| chunk.last_ns);
        let found = self.files.iter().find(|file| ends(file) >= at_ns);
        found.or(self.files.last()).map(|file| file.path.as_path())
    }

    /// Messages that the recording lacks, as its last complete file counts them: the service,
    /// and how many were lost in the queue, in memory and at the disk.
    pub fn lost(&self) -> impl Iterator<Item = (&str, &str)> {
        let counted = self.files.iter().rev().find(|file| file.damage.is_none());
        let lost = counted.into_iter().flat_map(|file| &file.lost);
        lost.map(|(service, counts)| (service.as_str(), counts.as_str()))
    }

    /// The channels, in the order of the first file.
    pub fn channels(&self) -> Vec<Arc<Channel>> {
        let mut channels: Vec<Arc<Channel>> = Vec::new();
        for channel in self.files.iter().flat_map(|file| file.channels.values()) {
            if !channels
                .iter()
                .any(|known| known.service == channel.service)
            {
                channels.push(channel.clone());
            }
        }
        channels
    }

    /// When the first and the last message were recorded, on the run's clock, ns; `None`
    /// without a message.
    pub fn span_ns(&self) -> Option<(u64, u64)> {
        let chunks = || self.files.iter().flat_map(|file| &file.chunks);
        let first_ns = chunks().next()?.first_ns;
        let last_ns = chunks().map(|chunk| chunk.last_ns).max()?;
        let offset_ns = self.origin().epoch_offset_ns;
        let run_ns = |ns: u64| ns.saturating_sub(offset_ns);
        Some((run_ns(first_ns), run_ns(last_ns)))
    }

    /// The messages of each service that the recording has any of. A file with its indexes
    /// is counted without reading its messages; a damaged chunk counts nothing.
    pub fn counts(&self) -> BTreeMap<String, Count> {
        let mut counts = BTreeMap::new();
        for file in self.files.iter() {
            count::count(file, &mut counts);
        }
        counts
    }

    /// Every message in order of time. See [`Entries::from_ns`] and [`Entries::from_tick`].
    pub fn entries(&self) -> Entries {
        Entries::new(self.files.clone(), None)
    }

    /// The messages of these services, such as `step` or `health/world`, in order of time.
    pub fn entries_of<'a>(&self, services: impl IntoIterator<Item = &'a str>) -> Entries {
        let services = services.into_iter().map(String::from).collect();
        Entries::new(self.files.clone(), Some(services))
    }

    /// The messages of one service; none when the recording has none of it. For messages of
    /// megabytes (frames, weights) use [`Recording::entries_of`].
    ///
    /// # Errors
    /// When they were recorded with another layout than this binary's.
    pub fn messages<M: Message>(
        &self,
        service: &Service<M>,
    ) -> Result<Messages<M>, RecordingError> {
        let ours = entry::layout::<M>();
        for file in self.files.iter() {
            for channel in file.channels.values() {
                if channel.service == service.name && channel.layout != ours {
                    return Err(RecordingError::Layout {
                        path: file.path.clone(),
                        service: service.name.into(),
                        theirs: channel.layout.clone(),
                        ours,
                        commit: file.origin.fact("commit").into(),
                    });
                }
            }
        }
        Ok(Messages::new(self.entries_of([service.name])))
    }

    /// The files added to the recording; each part of a run has its own configuration.
    pub fn attachments(&self) -> impl Iterator<Item = &Attachment> {
        self.files.iter().flat_map(|file| &file.attachments)
    }

    /// The data of an attachment.
    ///
    /// # Errors
    /// When it cannot be read or its checksum is wrong.
    pub fn data(&self, attachment: &Attachment) -> Result<Vec<u8>, RecordingError> {
        let path = &self.files[attachment.file].path;
        let damaged = |what: String| RecordingError::Damaged {
            path: path.clone(),
            part: "an attachment",
            offset: attachment.place.offset,
            what,
        };
        // Name, times and checksum are around the data.
        if attachment.bytes.saturating_add(20) > attachment.place.length {
            return Err(damaged("its length".into()));
        }
        let body = index::read(path, attachment.place, ATTACHMENT_MAX)?;
        match mcap::parse_record(op::ATTACHMENT, &body) {
            Ok(Record::Attachment { data, .. }) => Ok(data.into_owned()),
            Ok(_) => Err(damaged("it is no attachment".into())),
            Err(error) => Err(damaged(error.to_string())),
        }
    }

    /// The data of the first attachment of this name; `None` when there is none.
    ///
    /// # Errors
    /// As [`Recording::data`].
    pub fn attachment(&self, name: &str) -> Result<Option<Vec<u8>>, RecordingError> {
        let found = self
            .attachments()
            .find(|attachment| attachment.name == name);
        found.map(|attachment| self.data(attachment)).transpose()
    }

    /// The configuration as it ran, TOML; `None` when the recording has none.
    ///
    /// # Errors
    /// As [`Recording::data`].
    pub fn configuration(&self) -> Result<Option<String>, RecordingError> {
        let text = self.attachment(CONFIGURATION)?;
        Ok(text.map(|text| String::from_utf8_lossy(&text).into_owned()))
    }

    /// The policy file whose SHA-256 begins with these eight bytes, as `weights_hash` of a
    /// step has them: an attachment or an offer; `None` when the recording does not have it.
    ///
    /// # Errors
    /// As [`Recording::data`].
    pub fn policy(&self, hash: u64) -> Result<Option<Vec<u8>>, RecordingError> {
        let name = format!("{POLICIES}{hash:016x}");
        let found = self
            .attachments()
            .find(|attachment| attachment.name.starts_with(&name));
        if let Some(attachment) = found {
            return self.data(attachment).map(Some);
        }
        let offers = self.offers.get_or_init(|| offers::times(self));
        let offered = offers.get(&hash);
        Ok(offered.and_then(|&recorded_ns| offers::find(self, hash, recorded_ns)))
    }
}

/// The recording's files in a folder, by name.
fn files_of(folder: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let entries = fs::read_dir(folder).map_err(RecordingError::io(folder))?;
    let paths = entries.flatten().map(|entry| entry.path());
    let mut files: Vec<_> = paths
        .filter(|path| path.extension().is_some_and(|ending| ending == ENDING))
        .collect();
    files.sort_unstable();
    match files.is_empty() {
        true => Err(RecordingError::Empty(folder.into())),
        false => Ok(files),
    }
}
