//! Messages in order of time, a chunk at a time.

use std::collections::BTreeSet;
use std::marker::PhantomData;
use std::sync::Arc;
use std::vec;

use shm_config::Message;
use shm_config::services::{OBSERVATION, STEP};

use super::Entry;
use super::chunk;
use super::entry;
use super::index::FileIndex;
use crate::RecordingError;

/// A chunk's place: the number of its file, and its own within the file.
type At = (usize, usize);

/// The messages of a recording in order of time. It holds those of one chunk in memory.
///
/// After an error it goes on with the next chunk.
#[derive(Debug, Clone)]
pub struct Entries {
    files: Arc<[FileIndex]>,
    services: Option<BTreeSet<String>>,
    next: At,
    /// The file of the messages in hand.
    file: usize,
    hand: vec::IntoIter<Entry>,
    /// Messages recorded before this time are skipped, epoch ns.
    from_ns: u64,
    /// Messages before the first observation or step of this tick are skipped.
    from_tick: Option<u64>,
}

impl Entries {
    pub(super) fn new(files: Arc<[FileIndex]>, services: Option<BTreeSet<String>>) -> Self {
        Self {
            files,
            services,
            next: (0, 0),
            file: 0,
            hand: Vec::new().into_iter(),
            from_ns: 0,
            from_tick: None,
        }
    }

    /// Begins at the first message recorded at this time of the run's clock, ns, or later.
    #[must_use]
    pub fn from_ns(mut self, run_ns: u64) -> Self {
        let offset_ns = self
            .files
            .first()
            .map_or(0, |file| file.origin.epoch_offset_ns);
        self.from_ns = run_ns.saturating_add(offset_ns);
        self.from_tick = None;
        self.hand = Vec::new().into_iter();
        let places = self.places();
        let place = places.partition_point(|at| self.chunk(*at).last_ns < self.from_ns);
        self.next = places.get(place).copied().unwrap_or((self.files.len(), 0));
        self
    }

    /// Begins at the first observation or step of this tick or a later one; with all
    /// messages of other services from then on.
    ///
    /// # Errors
    /// When a chunk that it looks into is damaged.
    pub fn from_tick(mut self, tick: u64) -> Result<Self, RecordingError> {
        self.from_ns = 0;
        self.from_tick = Some(tick);
        self.hand = Vec::new().into_iter();
        let places = self.places();
        // The first chunk whose last tick is this one or later.
        let (mut low, mut high) = (0, places.len());
        while low < high {
            let middle = low + (high - low) / 2;
            // A chunk without a tick stands for the one before it.
            let mut last = None;
            let mut at = middle;
            while last.is_none() && at >= low {
                last = self.last_tick(places[at])?;
                match at.checked_sub(1) {
                    Some(before) if last.is_none() => at = before,
                    _ => break,
                }
            }
            match last {
                Some(last) if last >= tick => high = at,
                _ => low = middle + 1,
            }
        }
        self.next = places.get(low).copied().unwrap_or((self.files.len(), 0));
        Ok(self)
    }

    fn places(&self) -> Vec<At> {
        let files = self.files.iter().enumerate();
        files
            .flat_map(|(file, index)| (0..index.chunks.len()).map(move |chunk| (file, chunk)))
            .collect()
    }

    fn chunk(&self, (file, chunk): At) -> super::chunk::Chunk {
        self.files[file].chunks[chunk]
    }

    fn last_tick(&self, at: At) -> Result<Option<u64>, RecordingError> {
        let index = &self.files[at.0];
        let ticked = |channel: &crate::Channel| {
            [OBSERVATION.name, STEP.name].contains(&channel.service.as_str())
        };
        let entries = chunk::entries(
            &index.path,
            self.chunk(at),
            (&index.channels, &index.made),
            ticked,
        )?;
        Ok(entries
            .iter()
            .filter_map(Entry::header)
            .map(|header| header.tick)
            .max())
    }

    /// Reads the next chunk; `None` after the last one.
    fn load(&mut self) -> Option<Result<(), RecordingError>> {
        let (file, number) = self.next;
        let index = self.files.get(file)?;
        let Some(chunk) = index.chunks.get(number) else {
            self.next = (file + 1, 0);
            return Some(Ok(()));
        };
        self.next.1 += 1;
        let services = &self.services;
        // A tick is found by messages that may not be wanted themselves.
        let finding = self.from_tick.is_some();
        let wanted = |channel: &crate::Channel| {
            finding
                || services
                    .as_ref()
                    .is_none_or(|names| names.contains(&channel.service))
        };
        match chunk::entries(&index.path, *chunk, (&index.channels, &index.made), wanted) {
            Ok(entries) => {
                self.file = file;
                self.hand = entries.into_iter();
                Some(Ok(()))
            }
            Err(error) => Some(Err(error)),
        }
    }

    /// Whether a message is skipped on the way to the beginning.
    fn skips(&mut self, entry: &Entry) -> bool {
        if entry.log_ns < self.from_ns {
            return true;
        }
        let Some(tick) = self.from_tick else {
            return false;
        };
        let ticked = entry.is(&OBSERVATION) || entry.is(&STEP);
        if ticked && entry.header().is_some_and(|header| header.tick >= tick) {
            self.from_tick = None;
            return false;
        }
        true
    }
}

impl Iterator for Entries {
    type Item = Result<Entry, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            while let Some(entry) = self.hand.next() {
                if self.skips(&entry) {
                    continue;
                }
                let names = self.services.as_ref();
                if names.is_none_or(|names| names.contains(&entry.channel.service)) {
                    return Some(Ok(entry));
                }
            }
            if let Err(error) = self.load()? {
                return Some(Err(error));
            }
        }
    }
}

/// The messages of one service in order of time.
#[derive(Debug, Clone)]
pub struct Messages<M> {
    entries: Entries,
    message: PhantomData<fn() -> M>,
}

impl<M: Message> Messages<M> {
    pub(super) fn new(entries: Entries) -> Self {
        Self {
            entries,
            message: PhantomData,
        }
    }

    /// As [`Entries::from_ns`].
    #[must_use]
    pub fn from_ns(self, run_ns: u64) -> Self {
        Self::new(self.entries.from_ns(run_ns))
    }

    /// As [`Entries::from_tick`].
    ///
    /// # Errors
    /// As [`Entries::from_tick`].
    pub fn from_tick(self, tick: u64) -> Result<Self, RecordingError> {
        Ok(Self::new(self.entries.from_tick(tick)?))
    }
}

impl<M: Message> Iterator for Messages<M> {
    type Item = Result<M, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        let entry = match self.entries.next()? {
            Ok(entry) => entry,
            Err(error) => return Some(Err(error)),
        };
        let index = &self.entries.files[self.entries.file];
        Some(entry::typed(&entry, (&index.path, &index.origin)))
    }
}
