//! Messages of more than one packet: a picture, a policy file.
//!
//! Zenoh cuts a long packet itself, but drops all of it when the connection is full for a
//! moment. A piece is sent again alone. The pieces of one message pass in order, a few at a
//! time, so that what else is sent need not wait for all of them.

use crate::flow::{Parcel, Received};

/// Most bytes of a piece: with all that is around it, it fits into one of Zenoh's batches of
/// 64 KiB, and takes 0.3 s at 1 Mbit/s, a third of the silence that ends a session.
pub const PIECE_BYTES: usize = 32 << 10;
/// Most pieces of a message: the largest policy file and what is with it.
pub const PIECES_MAX: u16 = 258;
/// Pieces on the way and not acknowledged: with a round trip of 100 ms 1.3 MB/s.
const WINDOW: u16 = 4;

/// How many pieces a message of so many bytes has; one at least.
pub fn count(bytes: usize) -> u16 {
    let count = bytes.div_ceil(PIECE_BYTES).max(1);
    u16::try_from(count).unwrap_or(u16::MAX)
}

/// What has come of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reached {
    /// The number of a message.
    pub sequence: u64,
    /// So many pieces of it; 0 when it and all before it are here or given up.
    pub pieces: u16,
}

impl Reached {
    /// All messages up to a number.
    pub fn all(sequence: u64) -> Self {
        Self {
            sequence,
            pieces: 0,
        }
    }
}

/// A message that is on its way in pieces.
#[derive(Debug, Clone, Copy)]
pub struct Sending {
    /// Its number.
    pub sequence: u64,
    acknowledged: u16,
    sent: u16,
    /// The most that were ever sent.
    most: u16,
    /// All of them.
    pieces: u16,
}

impl Sending {
    /// Nothing of it is sent.
    pub fn new(sequence: u64, pieces: u16) -> Self {
        Self {
            sequence,
            pieces,
            acknowledged: 0,
            sent: 0,
            most: 0,
        }
    }

    /// The number of the next piece; `None` when it has to wait, or all are sent.
    pub fn next_piece(&mut self) -> Option<u16> {
        if self.sent >= self.pieces.min(self.acknowledged + WINDOW) {
            return None;
        }
        self.sent += 1;
        self.most = self.most.max(self.sent);
        Some(self.sent - 1)
    }

    /// Whether all pieces are sent.
    pub fn is_sent(&self) -> bool {
        self.sent == self.pieces
    }

    /// The other side has so many; whether that is more than before.
    pub fn acknowledge(&mut self, pieces: u16) -> bool {
        // More than was sent may be here since an earlier session.
        let is_new = (self.acknowledged + 1..=self.pieces).contains(&pieces);
        if is_new {
            self.acknowledged = pieces;
            self.sent = self.sent.max(pieces);
            self.most = self.most.max(pieces);
        }
        is_new
    }

    /// Whether pieces are on the way.
    pub fn is_waiting(&self) -> bool {
        self.sent > self.acknowledged
    }

    /// Whether all that was ever sent is acknowledged.
    pub fn is_answered(&self) -> bool {
        self.acknowledged == self.most
    }

    /// Begins again at the first piece that is missing; how many were on the way.
    pub fn go_back(&mut self) -> u16 {
        std::mem::replace(&mut self.sent, self.acknowledged) - self.acknowledged
    }
}

/// The piece of a message.
pub fn piece(bytes: &[u8], number: u16) -> &[u8] {
    let from = (usize::from(number) * PIECE_BYTES).min(bytes.len());
    &bytes[from..bytes.len().min(from + PIECE_BYTES)]
}

/// A message that comes in pieces.
#[derive(Debug)]
pub struct Assembly {
    /// Its number.
    pub sequence: u64,
    pieces: u16,
    here: u16,
    bytes: Vec<u8>,
    is_told: bool,
}

impl Assembly {
    /// Nothing of the message of this piece is here.
    pub fn new(parcel: &Parcel) -> Self {
        Self {
            sequence: parcel.sequence,
            pieces: parcel.pieces,
            here: 0,
            bytes: Vec::new(),
            is_told: true,
        }
    }

    /// Adds a piece of its message; the whole message when it was the last one.
    pub fn add(&mut self, parcel: &Parcel, received: &mut Received) -> Option<Parcel> {
        match parcel.piece.cmp(&self.here) {
            _ if parcel.pieces != self.pieces => received.reordered += 1,
            std::cmp::Ordering::Greater => received.reordered += 1,
            std::cmp::Ordering::Less => {
                received.doubled += 1;
                // The acknowledgement may be what was lost.
                self.is_told = false;
            }
            std::cmp::Ordering::Equal => {
                self.bytes.extend_from_slice(&parcel.bytes);
                self.here += 1;
                self.is_told = false;
            }
        }
        (self.here == self.pieces).then(|| Parcel {
            piece: 0,
            pieces: 1,
            bytes: std::mem::take(&mut self.bytes).into(),
            ..*parcel
        })
    }

    /// How many pieces are here, when the other side does not know it yet.
    pub fn news(&mut self) -> Option<Reached> {
        let is_told = std::mem::replace(&mut self.is_told, true);
        (!is_told && self.here > 0).then_some(Reached {
            sequence: self.sequence,
            pieces: self.here,
        })
    }
}
