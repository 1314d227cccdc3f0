//! What the reader of a run and the clients share: the newest message of each topic.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use recorder::Channel;
use recorder::standard::Topic;
use shm_config::services::STEP;
use tokio::sync::watch;

/// The newest message of a topic.
#[derive(Debug, Clone, Default)]
pub(super) struct Newest {
    /// Counts the topic's messages from 1; 0 before the first.
    pub(super) number: u64,
    /// When it was published, epoch ns.
    pub(super) epoch_ns: u64,
    /// ROS 2 CDR.
    pub(super) cdr: Bytes,
}

/// The newest message of each topic, and what became of it.
#[derive(Debug)]
pub struct Board {
    channels: Vec<Channel>,
    newest: Mutex<Vec<Newest>>,
    changed: watch::Sender<u64>,
    clients: AtomicUsize,
    sent: AtomicU64,
    skipped: AtomicU64,
}

impl Default for Board {
    fn default() -> Self {
        let mut channels: Vec<_> = Topic::ALL.map(Topic::channel).into();
        channels.push(Channel::of(&STEP.row, STEP.name));
        Self {
            newest: Mutex::new(vec![Newest::default(); channels.len()]),
            channels,
            changed: watch::Sender::new(0),
            clients: AtomicUsize::new(0),
            sent: AtomicU64::new(0),
            skipped: AtomicU64::new(0),
        }
    }
}

impl Board {
    /// The place of a standard topic.
    pub fn place(topic: Topic) -> usize {
        topic as usize
    }

    /// The place of the steps as they are.
    pub fn steps(&self) -> usize {
        Topic::ALL.len()
    }

    /// The channels, by place.
    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }

    fn all(&self) -> MutexGuard<'_, Vec<Newest>> {
        // Each is replaced whole.
        self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Replaces the newest message of a topic.
    pub fn put(&self, place: usize, epoch_ns: u64, cdr: &[u8]) {
        if let Some(newest) = self.all().get_mut(place) {
            *newest = Newest {
                number: newest.number + 1,
                epoch_ns,
                cdr: Bytes::copy_from_slice(cdr),
            };
        }
    }

    /// Wakes the clients, after one or more messages.
    pub fn wake(&self) {
        self.changed.send_modify(|count| *count += 1);
    }

    pub(super) fn listen(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// The newest message of a topic; `None` before the first.
    pub(super) fn newest(&self, place: usize) -> Option<Newest> {
        self.all()
            .get(place)
            .filter(|newest| newest.number > 0)
            .cloned()
    }

    /// Whether any client is there: without one, nothing needs to be made.
    pub fn is_watched(&self) -> bool {
        self.clients.load(Ordering::Relaxed) > 0
    }

    /// Counts a client in; `None` when there are `most` already.
    pub(super) fn enter(self: &Arc<Self>, most: usize) -> Option<Entered> {
        let entered = Entered(self.clone());
        match self.clients.fetch_add(1, Ordering::SeqCst) < most {
            true => Some(entered),
            // Dropping it counts it out again.
            false => None,
        }
    }

    pub(super) fn count_sent(&self, skipped: u64) {
        self.sent.fetch_add(1, Ordering::Relaxed);
        self.skipped.fetch_add(skipped, Ordering::Relaxed);
    }

    /// Messages that clients got, and those that newer ones replaced before a slow client
    /// had room for them.
    pub fn counts(&self) -> (u64, u64) {
        let count = |of: &AtomicU64| of.load(Ordering::Relaxed);
        (count(&self.sent), count(&self.skipped))
    }
}

/// A client that is counted as long as it lives.
#[derive(Debug)]
pub(super) struct Entered(Arc<Board>);

impl Drop for Entered {
    fn drop(&mut self) {
        self.0.clients.fetch_sub(1, Ordering::SeqCst);
    }
}
