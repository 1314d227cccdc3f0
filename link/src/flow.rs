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

use crate::pieces::{self, Assembly, Reached, Sending};
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
pub(crate) const WINDOW_NEWEST: u64 = 8;
/// Longest time that is measured between two acknowledgements of pieces, ns; what does not
/// come for twice of it is sent again.
const SLOW_NS_MAX: u64 = 500_000_000;

/// One message on its way.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Parcel {
    /// Its row.
    pub row: RowId,
    /// Its number in the row.
    pub sequence: u64,
    /// The oldest message of the row that the sender still has.
    pub oldest: u64,
    /// Which piece of the message it is, from 0.
    pub piece: u16,
    /// How many pieces the message has.
    pub pieces: u16,
    /// The message, or its piece.
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
    /// Neither acknowledged nor replaced nor lost yet.
    pub waiting: u64,
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
    /// The message that is on its way in pieces: one of a row at a time.
    large: Option<Sending>,
    /// The longest time between two acknowledgements of pieces lately, ns: on a slow network
    /// a piece takes longer than a ping there and back.
    slow_ns: u64,
    /// When more pieces were acknowledged than before, or the first was sent.
    progressed: Instant,
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
            // A message that is on its way in pieces is sent to its end: else, where each
            // takes longer than the next one, none would arrive.
            let begun = self.large.map(|large| large.sequence);
            self.replace(|number| Some(number) == begun);
        }
        self.held.push_back((self.last, bytes));
        while self.held.len() > QUEUE_MAX || self.bytes > QUEUE_BYTES_MAX {
            let Some((number, old)) = self.held.pop_front() else {
                break;
            };
            self.large = self.large.filter(|large| large.sequence != number);
            self.bytes -= old.len();
            self.sent.lost += 1;
        }
    }

    /// Drops the messages that a newer one replaces.
    fn replace(&mut self, stays: impl Fn(u64) -> bool) {
        self.held.retain(|(number, old)| {
            let is_kept = stays(*number);
            if !is_kept {
                self.bytes -= old.len();
                self.sent.replaced += 1;
            }
            is_kept
        });
    }

    fn begin_again(&mut self) {
        self.sent_to = self.sent.acknowledged;
        self.large = None;
        if self.passage == Passage::Newest {
            let newest = self.last;
            self.replace(|number| number == newest);
        }
    }

    fn acknowledge(&mut self, reached: Reached, now: Instant) {
        let sequence = reached.sequence;
        if let Some(large) = self
            .large
            .as_mut()
            .filter(|large| large.sequence == sequence)
        {
            if reached.pieces == 0 || large.acknowledge(reached.pieces) {
                let since_ns = now.since_ns(self.progressed);
                self.slow_ns = since_ns.max(self.slow_ns / 8 * 7).min(SLOW_NS_MAX);
                self.progressed = now;
            }
            // What came twice shows that the network is slow and loses nothing.
            self.moved = now;
        }
        if reached.pieces > 0 {
            return;
        }
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
        self.large = self.large.filter(|large| large.sequence > sequence);
    }

    /// Goes back to the first message that is missing when no acknowledgement comes.
    fn go_back(&mut self, (now, wait_ns): (Instant, u64), oldest: u64) {
        let is_large = self.large.is_some_and(|large| large.is_waiting());
        let wait_ns = match is_large {
            true => wait_ns + 2 * self.slow_ns,
            false => wait_ns,
        };
        let is_waiting = self.sent_to > self.sent.acknowledged || is_large;
        if !is_waiting || now.since_ns(self.moved) <= wait_ns {
            return;
        }
        self.sent.again += self.sent_to.saturating_sub(oldest - 1);
        self.sent_to = self.sent.acknowledged;
        if let Some(large) = &mut self.large {
            self.sent.again += u64::from(large.go_back());
        }
    }

    fn due(&mut self, row: RowId, (now, wait_ns): (Instant, u64), give: &mut dyn FnMut(Parcel)) {
        let Some((oldest, _)) = self.held.front() else {
            return;
        };
        let oldest = *oldest;
        self.go_back((now, wait_ns), oldest);
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
            let sequence = *sequence;
            let parcel = |piece: u16, pieces: u16, bytes| Parcel {
                row,
                sequence,
                oldest,
                piece,
                pieces,
                bytes,
            };
            let pieces = pieces::count(bytes.len());
            if pieces > 1 {
                let large = self.large.get_or_insert(Sending::new(sequence, pieces));
                if large.sequence != sequence {
                    break;
                }
                if large.is_answered() {
                    self.progressed = now;
                }
                while let Some(piece) = large.next_piece() {
                    self.moved = now;
                    give(parcel(piece, pieces, pieces::piece(bytes, piece).into()));
                }
                if !large.is_sent() {
                    break;
                }
            } else {
                give(parcel(0, 1, bytes.clone()));
                self.moved = now;
            }
            self.sent_to = sequence;
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
            large: None,
            slow_ns: 0,
            progressed: Instant(0),
            sent_to: 0,
            moved: Instant(0),
            sent: Sent::default(),
        });
        outgoing.push(bytes);
    }

    /// The peer has this of a row, or has given it up.
    pub fn acknowledge(&mut self, row: RowId, reached: Reached, now: Instant) {
        if let Some(outgoing) = self.rows.get_mut(&row) {
            outgoing.acknowledge(reached, now);
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
        self.rows.values_mut().for_each(Outgoing::begin_again);
    }

    /// Drops what waits: it is of a run that has ended.
    pub fn clear(&mut self) {
        for outgoing in self.rows.values_mut() {
            outgoing.replace(|_| false);
            outgoing.large = None;
        }
    }

    /// What each row has sent.
    pub fn sent(&self) -> impl Iterator<Item = (RowId, Sent)> {
        self.rows.iter().map(|(row, outgoing)| {
            let waiting = outgoing.held.len() as u64;
            let sent = Sent {
                waiting,
                ..outgoing.sent
            };
            (*row, sent)
        })
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
    /// The message that comes in pieces.
    assembly: Option<Assembly>,
    received: Received,
}

impl Incoming {
    /// The whole message when this was its last piece.
    fn assemble(&mut self, parcel: Parcel) -> Option<Parcel> {
        let is_here = self.last.is_some_and(|last| parcel.sequence <= last)
            || self.early.contains_key(&parcel.sequence);
        if is_here {
            self.received.doubled += 1;
            self.acknowledged = 0;
            return None;
        }
        let is_newer = |assembly: &Assembly| parcel.sequence > assembly.sequence;
        if self.assembly.as_ref().is_none_or(is_newer) {
            self.assembly = Some(Assembly::new(&parcel));
        }
        let assembly = self.assembly.as_mut();
        match assembly.filter(|assembly| assembly.sequence == parcel.sequence) {
            Some(assembly) => {
                let whole = assembly.add(&parcel, &mut self.received)?;
                self.assembly = None;
                Some(whole)
            }
            None => {
                self.received.reordered += 1;
                None
            }
        }
    }

    fn take(&mut self, parcel: Parcel, passage: Passage, give: &mut dyn FnMut(Parcel)) {
        let whole = match parcel.pieces {
            1 => Some(parcel),
            _ => self.assemble(parcel),
        };
        let Some(parcel) = whole else {
            return;
        };
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
    pub fn acknowledge(&mut self, mut give: impl FnMut(RowId, Reached)) {
        for (row, incoming) in &mut self.rows {
            let last = incoming.last.unwrap_or(0);
            if last > incoming.acknowledged {
                incoming.acknowledged = last;
                give(*row, Reached::all(last));
            }
            if let Some(reached) = incoming.assembly.as_mut().and_then(Assembly::news) {
                give(*row, reached);
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
mod tests;
