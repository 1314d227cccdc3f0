use std::fs;
use std::io;
use std::os::unix::process::parent_id;
use std::path::PathBuf;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{self, JoinHandle};

use shm_config::config::{Config, GateMode};
use shm_config::file::{self, Durable, Folder, make_folders};
use shm_config::judged::{Judged, SUMMARY};
use shm_config::text::printable_json;

use super::store::{Lost, Store, StoreError};
use super::{Filed, tally};

/// Records that may wait for the disk. Further ones are lost in real time, and counted; a
/// run in lockstep waits for the disk.
const WAITING_MAX: usize = 64;

/// Longest summary that is read back, bytes.
const SUMMARY_BYTES_MAX: u64 = 1 << 16;

/// Counts questions and answers, and stores the records if configured. It runs on its
/// own thread, so that a slow disk delays no advice.
pub struct Archive {
    entries: Option<SyncSender<Entry>>,
    thread: Option<JoinHandle<()>>,
    is_lockstep: bool,
    lost: u64,
    /// The counts as they were last sent to the thread.
    trouble: String,
}

/// What the thread receives.
enum Entry {
    Record(Box<Filed>),
    Trouble(String),
}

impl Archive {
    /// Opens the archive of a run's folder; records are in its folder `judge`. Records
    /// of an earlier run of the same name move to `judge-before`. When the gate was
    /// restarted, it appends to the records of this run. A replay stores no record,
    /// because it has one already.
    ///
    /// # Errors
    /// When the folder cannot be made.
    pub fn open(config: &Config) -> Result<Self, StoreError> {
        let path = PathBuf::from(&config.run.folder);
        let opened = make_folders(&path).and_then(|()| Folder::open(&path, file::Entry::Readable));
        let run_folder = opened.map_err(|source| StoreError::new(&path, source))?;
        let ours = before(&run_folder);
        let is_kept = config.gate.record && config.gate.mode != GateMode::Replay;
        if is_kept && ours.is_none() {
            make_room(&run_folder);
        }
        let mut store = is_kept
            .then(|| Store::open(&path.join("judge"), config.vlm.record_bytes_max))
            .transpose()?;
        let (entries, inbox) = sync_channel::<Entry>(WAITING_MAX);
        let mut judged = ours.unwrap_or_else(|| tally::begin(config, parent_id()));
        let thread = thread::spawn(move || {
            write_summary(&run_folder, &judged);
            while let Ok(entry) = inbox.recv() {
                // One summary for all entries that have come meanwhile.
                for entry in std::iter::once(entry).chain(inbox.try_iter()) {
                    match entry {
                        Entry::Record(filed) => {
                            tally::count(&mut judged, &filed.record);
                            if let Some(store) = &mut store {
                                judged.lost = keep(store, *filed);
                            }
                        }
                        Entry::Trouble(trouble) => judged.trouble = trouble,
                    }
                }
                write_summary(&run_folder, &judged);
            }
            if let Some(store) = &store {
                warn_of_lost(store.lost());
            }
        });
        Ok(Self {
            entries: Some(entries),
            thread: Some(thread),
            is_lockstep: config.run.is_lockstep(),
            lost: 0,
            trouble: String::new(),
        })
    }

    /// Sends records to the thread; in real time those that do not fit into its queue are
    /// lost.
    pub fn keep(&mut self, filed: Vec<Filed>) {
        for filed in filed {
            if !self.hand_over(Entry::Record(Box::new(filed))) {
                self.lost += 1;
            }
        }
    }

    /// Reports immediately why the server gets no more questions. The records of the
    /// questions come later, because they wait for the aftermath.
    pub fn warn(&mut self, trouble: &str) {
        if self.trouble != trouble && self.hand_over(Entry::Trouble(trouble.into())) {
            self.trouble = trouble.into();
        }
    }

    /// Sends an entry; returns whether the queue had room.
    fn hand_over(&self, entry: Entry) -> bool {
        let Some(entries) = &self.entries else {
            return false;
        };
        match self.is_lockstep {
            // The run's clock stands still meanwhile.
            true => entries.send(entry).is_ok(),
            false => entries.try_send(entry).is_ok(),
        }
    }

    /// Waits until everything sent is written.
    pub fn close(&mut self) {
        drop(self.entries.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        if self.lost > 0 {
            tracing::warn!(lost = self.lost, "records of questions were lost");
        }
    }
}

/// Stores a record; returns how many could not be stored so far.
fn keep(store: &mut Store, filed: Filed) -> u64 {
    let question = store.begin(filed.record, &filed.pictures);
    store.complete(question);
    let lost = store.lost();
    lost.lines + lost.pictures
}

fn warn_of_lost(lost: &Lost) {
    let Lost {
        lines,
        pictures,
        reason,
    } = lost;
    if lines + pictures > 0 {
        tracing::warn!(
            lines,
            pictures,
            reason,
            "some records of questions could not be stored"
        );
    }
}

/// Replaces the whole file or nothing. The store counts what a full disk refuses.
fn write_summary(run_folder: &Folder, judged: &Judged) {
    let text = serde_json::to_string(judged).unwrap_or_default();
    let text = printable_json(&text);
    // The file is not flushed to the disk: one is written for each record, and records
    // would wait.
    let _ = run_folder.replace(SUMMARY, text.as_bytes(), Durable::No);
}

/// The summary of an earlier gate of this run, because the supervisor outlives its
/// gates. Without one the counts begin at zero.
fn before(run_folder: &Folder) -> Option<Judged> {
    let text = run_folder.read_text(SUMMARY, SUMMARY_BYTES_MAX).ok()?;
    let judged: Judged = serde_json::from_str(&text).ok()?;
    (judged.supervisor == parent_id()).then_some(judged)
}

/// Moves the records of another run to another folder.
fn make_room(run_folder: &Folder) {
    if run_folder.look("judge").is_err() {
        return;
    }
    // A link is removed; its target is not touched.
    let moved = fs::remove_dir_all(run_folder.path().join("judge-before"))
        .or_else(|error| match error.kind() {
            io::ErrorKind::NotFound => Ok(()),
            _ => Err(error),
        })
        .and_then(|()| run_folder.rename("judge", "judge-before"));
    if let Err(error) = moved {
        tracing::warn!(%error, "the records of the earlier run cannot be moved; those of this run are appended to them");
    }
}
