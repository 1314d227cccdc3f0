use std::collections::VecDeque;
use std::fs;
use std::io;
use std::os::unix::process::parent_id;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use shm_config::config::{Config, GateMode};
use shm_config::file::{self, Durable, Folder, make_folders};
use shm_config::judged::{Judged, SUMMARY};
use shm_config::text::printable_json;

use super::store::{Lost, Store, StoreError};
use super::{Filed, tally};

/// Entries that may wait for the disk. A run in lockstep waits for room, for a limited time.
const WAITING_MAX: usize = 64;

/// Longest summary that is read back, bytes.
const SUMMARY_BYTES_MAX: u64 = 1 << 16;

/// Counts questions and answers, and stores the records if configured. It runs on its
/// own thread, so that a slow disk delays no advice.
pub struct Archive {
    entries: Option<SyncSender<Entry>>,
    /// Says that the thread has taken an entry.
    taken: Receiver<()>,
    thread: Option<JoinHandle<()>>,
    /// Entries for which the queue had no room.
    waiting: VecDeque<Entry>,
    lost: usize,
    /// The last reason given to [`Archive::warn`].
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
        let mut judged = ours.unwrap_or_else(|| tally::begin(config, parent_id()));
        Ok(Self::served(move |inbox, taken| {
            write_summary(&run_folder, &judged);
            while let Ok(entry) = inbox.recv() {
                // One summary for the entries that have come meanwhile.
                for entry in batch(entry, inbox.try_iter()) {
                    // Full when no one waits for it.
                    let _ = taken.try_send(());
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
        }))
    }

    /// An archive whose thread does this until the queue closes.
    fn served(serve: impl FnOnce(Receiver<Entry>, SyncSender<()>) + Send + 'static) -> Self {
        let (entries, inbox) = sync_channel(WAITING_MAX);
        let (took, taken) = sync_channel(1);
        Self {
            entries: Some(entries),
            taken,
            thread: Some(thread::spawn(move || serve(inbox, took))),
            waiting: VecDeque::new(),
            lost: 0,
            trouble: String::new(),
        }
    }

    /// Sends records to the thread as far as its queue has room, and never blocks. The caller
    /// says what becomes of the others: it tries again ([`Archive::hand_over`]) or gives them
    /// up ([`Archive::give_up`]).
    pub fn keep(&mut self, filed: Vec<Filed>) {
        let records = filed.into_iter().map(Box::new).map(Entry::Record);
        self.waiting.extend(records);
        self.hand_over();
    }

    /// Reports immediately why the server gets no more questions. The records of the
    /// questions come later, because they wait for the aftermath.
    pub fn warn(&mut self, trouble: &str) {
        if self.trouble != trouble {
            self.trouble = trouble.into();
            // The newest reason alone is shown.
            self.waiting
                .retain(|entry| matches!(entry, Entry::Record(_)));
            self.waiting.push_front(Entry::Trouble(trouble.into()));
            self.hand_over();
        }
    }

    /// Sends what waits, as far as the queue has room; returns whether all of it is sent.
    pub fn hand_over(&mut self) -> bool {
        while let (Some(entries), Some(entry)) = (&self.entries, self.waiting.pop_front()) {
            match entries.try_send(entry) {
                Ok(()) => {}
                Err(TrySendError::Full(entry)) => {
                    self.waiting.push_front(entry);
                    return false;
                }
                Err(TrySendError::Disconnected(entry)) => {
                    // The thread has ended: room will never come.
                    self.waiting.push_front(entry);
                    self.give_up();
                    return true;
                }
            }
        }
        true
    }

    /// Waits until the thread takes an entry, at most this long.
    pub fn wait_for_room(&self, timeout: Duration) {
        let _ = self.taken.recv_timeout(timeout);
    }

    /// Counts the records that wait as lost. A warning stays, because it is not repeated.
    pub fn give_up(&mut self) {
        let before = self.waiting.len();
        self.waiting
            .retain(|entry| matches!(entry, Entry::Trouble(_)));
        self.lost += before - self.waiting.len();
    }

    /// Waits until everything sent, and what waits, is written.
    pub fn close(&mut self) {
        if let Some(entries) = self.entries.take() {
            for entry in self.waiting.drain(..) {
                // Nothing is delayed any more: the loop is over.
                let is_record = matches!(entry, Entry::Record(_));
                let is_lost = entries.send(entry).is_err() && is_record;
                self.lost += usize::from(is_lost);
            }
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        if self.lost > 0 {
            tracing::warn!(lost = self.lost, "records of questions were lost");
        }
    }
}

/// The entries of one summary. They are limited: while a producer refills the queue, it is
/// never empty.
fn batch<T>(first: T, more: impl Iterator<Item = T>) -> impl Iterator<Item = T> {
    std::iter::once(first).chain(more.take(WAITING_MAX))
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

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use shm_config::config::SafetyLimits;
    use shm_config::message::Step;
    use vehicle::Vehicle;

    use super::*;
    use crate::judge::Rules;
    use crate::query::{Immediate, Occasion};
    use crate::record::QueryLog;

    fn filed(count: usize) -> Vec<Filed> {
        let rules = Rules::new(Vehicle::default(), SafetyLimits::default());
        let queue = Immediate::new(rules);
        let mut log = QueryLog::new(0);
        for _ in 0..count {
            log.asked(&Step::default(), Occasion::Period, &queue);
        }
        log.finish()
    }

    /// An archive with a disk that hangs until this sender is dropped, and the number of
    /// entries that are written then.
    fn stalled() -> (Archive, std::sync::mpsc::Sender<()>, Receiver<usize>) {
        let (stall, stalls) = channel::<()>();
        let (written, count) = channel();
        let archive = Archive::served(move |inbox, taken| {
            let _ = stalls.recv();
            let entries = inbox.iter().inspect(|_| {
                let _ = taken.try_send(());
            });
            let _ = written.send(entries.count());
        });
        (archive, stall, count)
    }

    #[test]
    fn a_hanging_disk_blocks_nothing_and_what_is_given_up_is_counted() {
        let (mut archive, stall, written) = stalled();
        archive.keep(filed(WAITING_MAX + 3));
        assert!(!archive.hand_over(), "three wait");
        archive.warn("no account");
        archive.wait_for_room(Duration::from_millis(1));
        archive.give_up();
        assert_eq!((archive.lost, archive.waiting.len()), (3, 1));
        // The disk goes on.
        drop(stall);
        while !archive.hand_over() {
            archive.wait_for_room(Duration::from_secs(60));
        }
        archive.keep(filed(1));
        archive.close();
        assert_eq!(written.recv(), Ok(WAITING_MAX + 2));
        assert_eq!(archive.lost, 3);
    }

    #[test]
    fn the_end_writes_what_waits() {
        let (mut archive, stall, written) = stalled();
        archive.keep(filed(WAITING_MAX + 3));
        drop(stall);
        archive.close();
        assert_eq!((archive.lost, written.recv()), (0, Ok(WAITING_MAX + 3)));
    }

    #[test]
    fn a_thread_that_has_ended_is_not_waited_for() {
        let mut archive = Archive::served(|inbox, taken| drop((inbox, taken)));
        archive.thread.take().map(JoinHandle::join);
        archive.keep(filed(2));
        assert!(archive.hand_over());
        archive.close();
        assert_eq!(archive.lost, 2);
    }

    #[test]
    fn a_summary_is_written_also_while_the_queue_is_refilled() {
        let entries = batch(0, std::iter::repeat(1));
        assert_eq!(entries.count(), 1 + WAITING_MAX);
    }
}
