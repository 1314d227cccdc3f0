use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{self, JoinHandle};

use shm_config::config::Config;
use shm_config::judged::{Judged, RUN, SUMMARY};

use crate::store::{Lost, Store, StoreError};
use crate::{Filed, tally};

/// Records that may wait for the disk; more are lost, and counted.
const WAITING_MAX: usize = 64;

/// Writes records on a thread of its own: a disk that stalls holds up no advice.
pub struct Archive {
    entries: Option<SyncSender<Entry>>,
    thread: Option<JoinHandle<()>>,
    lost: u64,
    /// As it was last handed over.
    trouble: String,
}

/// What the archive takes in.
enum Entry {
    Record(Box<Filed>),
    Trouble(String),
}

impl Archive {
    /// Of the run's folder, `judge` in it. The records of a run of the same name
    /// before go to `judge-before`; those of this one are gone on with, when the
    /// gate was restarted.
    ///
    /// # Errors
    /// When the folder cannot be made.
    pub fn open(config: &Config) -> Result<Self, StoreError> {
        let run_folder = PathBuf::from(&config.run.folder);
        let folder = run_folder.join("judge");
        make_room(&run_folder);
        let mut store = Store::open(&folder, config.vlm.record_bytes_max)?;
        // Without it the next gate of this run begins anew: no harm.
        let _ = fs::write(run_folder.join(RUN), run_id());
        let (entries, inbox) = sync_channel::<Entry>(WAITING_MAX);
        let mut judged = tally::begin(config);
        let thread = thread::spawn(move || {
            write_summary(&run_folder, &judged);
            while let Ok(entry) = inbox.recv() {
                match entry {
                    Entry::Record(filed) => {
                        tally::count(&mut judged, &filed.record);
                        let question = store.begin(filed.record, &filed.pictures);
                        store.complete(question);
                        let lost = store.lost();
                        judged.lost = lost.lines + lost.pictures;
                    }
                    Entry::Trouble(trouble) => judged.trouble = trouble,
                }
                write_summary(&run_folder, &judged);
            }
            let Lost {
                lines,
                pictures,
                reason,
            } = store.lost();
            if lines + pictures > 0 {
                tracing::warn!(lines, pictures, reason, "not all was kept of the questions");
            }
        });
        Ok(Self {
            entries: Some(entries),
            thread: Some(thread),
            lost: 0,
            trouble: String::new(),
        })
    }

    /// Hands records over; those for which there is no room are lost.
    pub fn keep(&mut self, filed: Vec<Filed>) {
        for filed in filed {
            if !self.hand_over(Entry::Record(Box::new(filed))) {
                self.lost += 1;
            }
        }
    }

    /// Says at once why the server is not asked any more: records wait for what
    /// follows their questions.
    pub fn warn(&mut self, trouble: &str) {
        if self.trouble != trouble && self.hand_over(Entry::Trouble(trouble.into())) {
            self.trouble = trouble.into();
        }
    }

    /// Whether there was room.
    fn hand_over(&self, entry: Entry) -> bool {
        let entries = self.entries.as_ref();
        entries.is_some_and(|entries| entries.try_send(entry).is_ok())
    }

    /// Waits until all that was handed over is written.
    pub fn close(mut self) {
        drop(self.entries.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        if self.lost > 0 {
            tracing::warn!(lost = self.lost, "records of questions were lost");
        }
    }
}

/// Whole or not at all; a disk that refuses is counted by the store.
fn write_summary(run_folder: &Path, judged: &Judged) {
    let text = serde_json::to_string(judged).unwrap_or_default();
    let path = run_folder.join(SUMMARY);
    let part = path.with_extension("part");
    let _ = fs::write(&part, text).and_then(|()| fs::rename(&part, &path));
}

/// The supervisor's process, which outlives its gates.
fn run_id() -> String {
    std::os::unix::process::parent_id().to_string()
}

/// Moves the records of another run out of the way.
fn make_room(run_folder: &Path) {
    let folder = &run_folder.join("judge");
    let is_ours = fs::read_to_string(run_folder.join(RUN)).is_ok_and(|run| run == run_id());
    if is_ours || !folder.exists() {
        return;
    }
    let before = folder.with_file_name("judge-before");
    let moved = fs::remove_dir_all(&before)
        .or_else(|error| match error.kind() {
            io::ErrorKind::NotFound => Ok(()),
            _ => Err(error),
        })
        .and_then(|()| fs::rename(folder, &before));
    if let Err(error) = moved {
        tracing::warn!(%error, "the records of the run before cannot be moved; those of this one follow them");
    }
}
