//! What of each row is on the way, acknowledged, lost: on both sides, without a clock or a
//! network of its own.
//!
//! Every message of a row has a number that counts from 1. A row of every message is kept
//! until it is acknowledged, in a queue of limited length, and sent again from the first one
//! that is missing when no acknowledgement comes. Each message also says which is the oldest
//! that its sender still has: what is older and did not arrive is lost, and counted there
//! and here. Of a row of newest messages only the newest is kept.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use serde::Serialize;
use shm_config::Instant;

use crate::role::{Passage, RowId};

/// Messages of a row of every message that wait: as many steps as a reader on the machine
/// may fall behind.
pub const QUEUE_MAX: usize = 2048;
/// Their bytes at most; four of the largest policy files.
pub const QUEUE_BYTES_MAX: usize = 32 << 20;
/// Messages of one row on the way and not acknowledged: a round trip of 100 ms carries 640
/// a second more than a learner at 100 Hz needs.
const WINDOW_EVERY: u64 = 64;
/// The same of a row of newest messages: more would only wait in the network's queues.
const WINDOW_NEWEST: u64 = 8;

/// One message on its way.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Parcel {
    /// Its row.
    pub row: RowId,
    /// Its number in the row.
    pub sequence: u64,
    /// The oldest message of the row that the sender still has.
    pub oldest: u64,
    /// The message.
    pub bytes: Arc<[u8]>,
}

/// What one row has sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Sent {
    /// Messages that were to be sent.
    pub messages: u64,
    /// Sent once more, because no acknowledgement came.
    pub again: u64,
    /// Acknowledged up to this number.
    pub acknowledged: u64,
    /// Of a row of newest messages: replaced by a newer one before it was acknowledged.
    pub replaced: u64,
    /// Of a row of every message: dropped at the full queue.
    pub lost: u64,
}

/// What one row has received.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Received {
    /// Messages taken.
    pub messages: u64,
    /// Of a row of newest messages: numbers that were skipped.
    pub skipped: u64,
    /// Received before.
    pub doubled: u64,
    /// Before their turn, or after a newer one; those of every message come again.
    pub reordered: u64,
    /// Of a row of every message: numbers that the sender has dropped.
    pub lost: u64,
}

#[derive(Debug)]
struct Outgoing {
    passage: Passage,
    /// The messages that are not acknowledged, the oldest first, with their numbers.
    held: VecDeque<(u64, Arc<[u8]>)>,
    bytes: usize,
    last: u64,
    /// The highest number that was sent since the last time of going back.
    sent_to: u64,
    /// When something was sent or acknowledged last.
    moved: Instant,
    sent: Sent,
}

impl Outgoing {
    fn push(&mut self, bytes: Arc<[u8]>) {
        self.last += 1;
        self.sent.messages += 1;
        self.bytes += bytes.len();
        if self.passage == Passage::Newest {
            while let Some((_, old)) = self.held.pop_front() {
                self.bytes -= old.len();
                self.sent.replaced += 1;
            }
        }
        self.held.push_back((self.last, bytes));
        while self.held.len() > QUEUE_MAX || self.bytes > QUEUE_BYTES_MAX {
            let Some((_, old)) = self.held.pop_front() else {
                break;
            };
            self.bytes -= old.len();
            self.sent.lost += 1;
        }
    }

    fn acknowledge(&mut self, sequence: u64, now: Instant) {
        // A number that was never sent acknowledges nothing.
        if sequence <= self.sent.acknowledged || sequence > self.last {
            return;
        }
        self.sent.acknowledged = sequence;
        self.sent_to = self.sent_to.max(sequence);
        self.moved = now;
        while let Some((number, bytes)) = self.held.front()
            && *number <= sequence
        {
            self.bytes -= bytes.len();
            self.held.pop_front();
        }
    }

    fn due(&mut self, row: RowId, (now, wait_ns): (Instant, u64), give: &mut dyn FnMut(Parcel)) {
        let Some((oldest, _)) = self.held.front() else {
            return;
        };
        let oldest = *oldest;
        let is_waiting = self.sent_to > self.sent.acknowledged;
        if is_waiting && now.since_ns(self.moved) > wait_ns {
            self.sent.again += self.sent_to.saturating_sub(oldest - 1);
            self.sent_to = self.sent.acknowledged;
        }
        let window = match self.passage {
            Passage::Every => WINDOW_EVERY,
            Passage::Newest => WINDOW_NEWEST,
        };
        // What was dropped unsent is not on the way.
        let begin = self.sent_to.max(oldest - 1);
        for (sequence, bytes) in &self.held {
            if *sequence <= begin {
                continue;
            }
            let base = match self.passage {
                Passage::Every => oldest - 1,
                Passage::Newest => self.sent.acknowledged,
            };
            let is_first = self.sent_to <= self.sent.acknowledged;
            if *sequence - base > window && !is_first {
                break;
            }
            self.sent_to = *sequence;
            self.moved = now;
            let (sequence, bytes) = (*sequence, bytes.clone());
            give(Parcel {
                row,
                sequence,
                oldest,
                bytes,
            });
        }
    }
}

/// What one peer is to receive.
#[derive(Debug, Default)]
pub struct Outbox {
    rows: BTreeMap<RowId, Outgoing>,
}

impl Outbox {
    /// Adds a message.
    pub fn push(&mut self, row: RowId, passage: Passage, bytes: Arc<[u8]>) {
        let outgoing = self.rows.entry(row).or_insert_with(|| Outgoing {
            passage,
            held: VecDeque::new(),
            bytes: 0,
            last: 0,
            sent_to: 0,
            moved: Instant(0),
            sent: Sent::default(),
        });
        outgoing.push(bytes);
    }

    /// The peer has all messages of a row up to this number, or has given them up.
    pub fn acknowledge(&mut self, row: RowId, sequence: u64, now: Instant) {
        if let Some(outgoing) = self.rows.get_mut(&row) {
            outgoing.acknowledge(sequence, now);
        }
    }

    /// Gives what is due: new messages, and those whose acknowledgement has not come within
    /// `wait_ns`.
    pub fn due(&mut self, now: Instant, wait_ns: u64, give: &mut dyn FnMut(Parcel)) {
        for (row, outgoing) in &mut self.rows {
            outgoing.due(*row, (now, wait_ns), give);
        }
    }

    /// Nothing that was sent has arrived as far as is known: a new connection begins at the
    /// first message that is not acknowledged.
    pub fn begin_again(&mut self) {
        for outgoing in self.rows.values_mut() {
            outgoing.sent_to = outgoing.sent.acknowledged;
        }
    }

    /// What each row has sent.
    pub fn sent(&self) -> impl Iterator<Item = (RowId, Sent)> {
        self.rows
            .iter()
            .map(|(row, outgoing)| (*row, outgoing.sent))
    }

    /// Whether everything is acknowledged.
    pub fn is_empty(&self) -> bool {
        self.rows.values().all(|outgoing| outgoing.held.is_empty())
    }
}

#[derive(Debug, Default)]
struct Incoming {
    last: Option<u64>,
    acknowledged: u64,
    /// Messages before their turn: at most a window of them.
    early: BTreeMap<u64, Parcel>,
    received: Received,
}

impl Incoming {
    fn take(&mut self, parcel: Parcel, passage: Passage, give: &mut dyn FnMut(Parcel)) {
        let received = &mut self.received;
        let (sequence, oldest) = (parcel.sequence, parcel.oldest);
        // What was before the first message that comes went to a process before this one, or
        // was dropped, which its sender counts.
        let last = match (self.last, passage) {
            (Some(last), _) => last,
            (None, Passage::Every) => oldest - 1,
            (None, Passage::Newest) => sequence - 1,
        };
        if sequence <= last || self.early.contains_key(&sequence) {
            match sequence == last || passage == Passage::Every {
                true => received.doubled += 1,
                false => received.reordered += 1,
            }
            // The acknowledgement may be what was lost.
            self.acknowledged = 0;
            return;
        }
        if passage == Passage::Newest {
            received.skipped += sequence - last - 1;
            received.messages += 1;
            self.last = Some(sequence);
            return give(parcel);
        }
        // What the sender does not have any more will not come, but may be here already.
        let mut last = last;
        while last + 1 < oldest {
            last += 1;
            match self.early.remove(&last) {
                Some(early) => {
                    received.messages += 1;
                    give(early);
                }
                None => {
                    let next = self.early.keys().next().copied().unwrap_or(oldest);
                    let next = next.min(oldest);
                    received.lost += next - last;
                    last = next - 1;
                }
            }
        }
        if sequence > last + 1 {
            received.reordered += 1;
            // One that is further ahead than its sender may be comes again.
            if sequence - last <= WINDOW_EVERY {
                self.early.insert(sequence, parcel);
            }
            self.last = Some(last);
            return;
        }
        last = sequence;
        received.messages += 1;
        give(parcel);
        while let Some(early) = self.early.remove(&(last + 1)) {
            last += 1;
            received.messages += 1;
            give(early);
        }
        self.last = Some(last);
    }
}

/// What came from one peer.
#[derive(Debug, Default)]
pub struct Inbox {
    rows: BTreeMap<RowId, Incoming>,
}

impl Inbox {
    /// Gives a message and those that waited for it, in their order; nothing when it was
    /// received before, or is before its turn.
    pub fn take(&mut self, parcel: Parcel, passage: Passage, give: &mut dyn FnMut(Parcel)) {
        self.rows
            .entry(parcel.row)
            .or_default()
            .take(parcel, passage, give);
    }

    /// Gives what is not acknowledged yet.
    pub fn acknowledge(&mut self, mut give: impl FnMut(RowId, u64)) {
        for (row, incoming) in &mut self.rows {
            let last = incoming.last.unwrap_or(0);
            if last > incoming.acknowledged {
                incoming.acknowledged = last;
                give(*row, last);
            }
        }
    }

    /// What each row has received.
    pub fn received(&self) -> impl Iterator<Item = (RowId, Received)> {
        self.rows
            .iter()
            .map(|(row, incoming)| (*row, incoming.received))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng as _, RngExt as _, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    const ROW: RowId = RowId(1);
    const MS: u64 = 1_000_000;

    fn message(number: u64) -> Arc<[u8]> {
        number.to_le_bytes().to_vec().into()
    }

    fn number(parcel: &Parcel) -> u64 {
        u64::from_le_bytes(parcel.bytes[..].try_into().expect("eight bytes"))
    }

    /// Sends over a network that loses, doubles, delays and reorders; returns what arrives.
    fn pass(seed: u64, passage: Passage, count: u64) -> (Vec<u64>, Outbox, Inbox) {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let (mut outbox, mut inbox) = (Outbox::default(), Inbox::default());
        let mut on_the_way: Vec<(u64, Parcel)> = Vec::new();
        let mut acks: Vec<(u64, u64)> = Vec::new();
        let mut arrived = Vec::new();
        for turn in 0..count * 40 {
            let now = Instant(turn * MS);
            if turn % 2 == 0 && turn / 2 < count {
                outbox.push(ROW, passage, message(turn / 2 + 1));
            }
            outbox.due(now, 50 * MS, &mut |parcel| {
                for _ in 0..1 + u32::from(random.random_ratio(1, 20)) {
                    if !random.random_ratio(1, 10) {
                        on_the_way.push((turn + random.next_u64() % 30, parcel.clone()));
                    }
                }
            });
            let (here, later): (Vec<_>, _) =
                on_the_way.into_iter().partition(|(at, _)| *at <= turn);
            on_the_way = later;
            for (_, parcel) in here {
                inbox.take(parcel, passage, &mut |parcel| arrived.push(number(&parcel)));
            }
            inbox.acknowledge(|_, last| {
                if !random.random_ratio(1, 10) {
                    acks.push((turn + 15, last));
                }
            });
            acks.retain(|(at, last)| {
                if *at <= turn {
                    outbox.acknowledge(ROW, *last, now);
                }
                *at > turn
            });
            if outbox.is_empty() && turn / 2 > count {
                break;
            }
        }
        (arrived, outbox, inbox)
    }

    #[test]
    fn every_message_arrives_once_and_in_order_over_a_network_that_does_all_wrong() {
        for seed in 0..8 {
            let (arrived, outbox, inbox) = pass(seed, Passage::Every, 500);
            assert_eq!(arrived, (1..=500).collect::<Vec<_>>(), "seed {seed}");
            let received = inbox.received().next().expect("a row").1;
            assert_eq!((received.messages, received.lost), (500, 0), "seed {seed}");
            assert!(
                received.doubled > 0 && received.reordered > 0,
                "seed {seed}"
            );
            assert!(
                outbox.sent().next().expect("a row").1.again > 0,
                "seed {seed}"
            );
        }
    }

    #[test]
    fn the_newest_arrives_at_last_and_never_after_a_newer_one() {
        for seed in 0..8 {
            let (arrived, _, inbox) = pass(seed, Passage::Newest, 300);
            assert_eq!(arrived.last(), Some(&300), "seed {seed}");
            assert!(arrived.is_sorted(), "seed {seed}");
            let received = inbox.received().next().expect("a row").1;
            let first = arrived[0];
            let counted = first - 1 + received.messages + received.skipped;
            assert_eq!(counted, 300, "seed {seed}");
        }
    }

    /// A partition longer than the queue: both sides count the same loss, and go on.
    #[test]
    fn what_the_full_queue_drops_is_counted_on_both_sides() {
        let (mut outbox, mut inbox) = (Outbox::default(), Inbox::default());
        let dropped = 300;
        let mut arrived = Vec::new();
        outbox.push(ROW, Passage::Every, message(0));
        outbox.due(Instant(0), 50 * MS, &mut |parcel| {
            inbox.take(parcel, Passage::Every, &mut |_| {});
        });
        inbox.acknowledge(|row, last| outbox.acknowledge(row, last, Instant(0)));
        for k in 1..=QUEUE_MAX as u64 + dropped {
            outbox.push(ROW, Passage::Every, message(k));
        }
        for turn in 0..200 {
            let now = Instant(turn * MS);
            let mut parcels = Vec::new();
            outbox.due(now, 50 * MS, &mut |parcel| parcels.push(parcel));
            for parcel in parcels {
                inbox.take(parcel, Passage::Every, &mut |parcel| {
                    arrived.push(number(&parcel))
                });
            }
            inbox.acknowledge(|row, last| outbox.acknowledge(row, last, now));
        }
        assert_eq!(arrived.first(), Some(&(dropped + 1)));
        assert_eq!(arrived.len(), QUEUE_MAX);
        assert_eq!(outbox.sent().next().expect("a row").1.lost, dropped);
        assert_eq!(inbox.received().next().expect("a row").1.lost, dropped);
    }

    #[test]
    fn a_false_acknowledgement_frees_nothing() {
        let mut outbox = Outbox::default();
        outbox.push(ROW, Passage::Every, message(1));
        outbox.acknowledge(ROW, 7, Instant(0));
        outbox.acknowledge(RowId(9), 1, Instant(0));
        assert!(!outbox.is_empty());
        outbox.acknowledge(ROW, 1, Instant(0));
        assert!(outbox.is_empty());
    }

    /// A cut in the middle: a new connection sends again what is not acknowledged, at once.
    #[test]
    fn a_new_connection_begins_at_the_first_message_that_is_missing() {
        let mut outbox = Outbox::default();
        for k in 1..=10 {
            outbox.push(ROW, Passage::Every, message(k));
        }
        let due = |outbox: &mut Outbox, at: u64| {
            let mut numbers = Vec::new();
            outbox.due(Instant(at), 50 * MS, &mut |parcel| {
                numbers.push(parcel.sequence)
            });
            numbers
        };
        assert_eq!(due(&mut outbox, 0).len(), 10);
        assert!(due(&mut outbox, MS).is_empty());
        outbox.acknowledge(ROW, 4, Instant(2 * MS));
        outbox.begin_again();
        assert_eq!(due(&mut outbox, 3 * MS), (5..=10).collect::<Vec<_>>());
    }
}
