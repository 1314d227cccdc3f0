//! What travels: the bytes of a packet.
//!
//! | part | bytes |
//! |---|---|
//! | `VLNK`, kind, three zeros | 8 |
//! | session | 8 |
//! | counter, from 1 in each session and direction | 8 |
//! | body | up to [`BODY_MAX`] |
//! | of a greeting: HMAC-SHA256 of all before it | 32 |
//! | of a session's packet, whose body is encrypted: the tag of body and head | 16 |
//!
//! All numbers are little-endian.

use ring::hmac;

use crate::cipher::{Cipher, TAG_BYTES};
use crate::flow::Parcel;
use crate::pieces::{PIECE_BYTES, PIECES_MAX};
use crate::role::RowId;

/// The first bytes.
const MAGIC: &[u8; 4] = b"VLNK";
/// Bytes before the body.
const HEAD: usize = 24;
/// Bytes behind the body of a greeting.
const SIGNATURE: usize = 32;
/// Bytes of a parcel before its message.
const PARCEL_HEAD: usize = 24;
/// Most bytes of a body: a piece of a message and what is with it.
pub const BODY_MAX: usize = PARCEL_HEAD + PIECE_BYTES;
/// Most bytes of a packet.
pub const PACKET_MAX: usize = HEAD + BODY_MAX + SIGNATURE;

shm_config::word_list! {
    /// What a packet is.
    pub enum Kind {
        /// A peer asks for a session.
        Hello = 1 "hello",
        /// The vehicle's answer.
        Welcome = 2 "welcome",
        /// The vehicle's refusal, which no key protects: it informs and decides nothing.
        Refusal = 3 "refusal",
        /// A message of a row.
        Message = 4 "message",
        /// Which messages have come.
        Acknowledgement = 5 "acknowledgement",
        /// Asks for the other clock.
        Ping = 6 "ping",
        /// Answers.
        Pong = 7 "pong",
        /// The sender ends the session.
        Bye = 8 "bye",
    }
}

impl Kind {
    /// Whether it is sent before there is a session, and therefore in clear text.
    pub fn is_greeting(self) -> bool {
        matches!(self, Self::Hello | Self::Welcome | Self::Refusal)
    }

    fn tag_bytes(self) -> usize {
        match self.is_greeting() {
            true => SIGNATURE,
            false => TAG_BYTES,
        }
    }
}

/// A packet, taken apart; nothing of it is trusted yet.
#[derive(Debug, Clone, Copy)]
pub struct Packet<'a> {
    /// What it is.
    pub kind: Kind,
    /// Its session.
    pub session: u64,
    /// Its number in the session.
    pub counter: u64,
    whole: &'a [u8],
}

impl<'a> Packet<'a> {
    /// Takes bytes apart; `None` when they are no packet.
    pub fn parse(bytes: &'a [u8]) -> Option<Self> {
        let mut reader = Reader(bytes);
        let [magic, kind, zeros] = [reader.take(4)?, reader.take(1)?, reader.take(3)?];
        if magic != MAGIC || zeros != [0; 3] {
            return None;
        }
        let kind = Kind::from_code(u32::from(kind[0]))?;
        let (session, counter) = (reader.u64()?, reader.u64()?);
        let body = reader.0.len().checked_sub(kind.tag_bytes())?;
        (body <= BODY_MAX).then_some(Self {
            kind,
            session,
            counter,
            whole: bytes,
        })
    }

    /// The body of a greeting, which anyone may have made; nothing of other packets.
    pub fn greeting(&self) -> &'a [u8] {
        match self.kind.is_greeting() {
            true => &self.whole[HEAD..self.whole.len() - SIGNATURE],
            false => &[],
        }
    }

    /// Whether it is a greeting that was made with this key, and not changed since.
    pub fn is_of(&self, key: &hmac::Key) -> bool {
        let (signed, tag) = self
            .whole
            .split_at(self.whole.len() - self.kind.tag_bytes());
        self.kind.is_greeting() && hmac::verify(key, signed, tag).is_ok()
    }

    /// The body of a session's packet; `None` when it was made with another key, or changed.
    pub fn open(&self, cipher: &Cipher) -> Option<Vec<u8>> {
        let (head, sealed) = self.whole.split_at(HEAD);
        match self.kind.is_greeting() {
            true => None,
            false => cipher.open(self.counter, head, sealed),
        }
    }
}

fn clear(kind: Kind, (session, counter): (u64, u64), body: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEAD + body.len() + SIGNATURE);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&[kind.code() as u8, 0, 0, 0]);
    bytes.extend_from_slice(&session.to_le_bytes());
    bytes.extend_from_slice(&counter.to_le_bytes());
    bytes.extend_from_slice(body);
    bytes
}

/// Makes a greeting.
pub fn sign(kind: Kind, body: &[u8], key: &hmac::Key) -> Vec<u8> {
    let mut bytes = clear(kind, (0, 0), body);
    let tag = hmac::sign(key, &bytes);
    bytes.extend_from_slice(tag.as_ref());
    bytes
}

/// Makes a packet of a session. A counter may be used once.
pub fn seal(kind: Kind, (session, counter): (u64, u64), body: &[u8], cipher: &Cipher) -> Vec<u8> {
    let mut bytes = clear(kind, (session, counter), body);
    cipher.seal(counter, &mut bytes, HEAD);
    bytes
}

/// The body of a message.
pub fn parcel_body(parcel: &Parcel) -> Vec<u8> {
    let mut body = Vec::with_capacity(PARCEL_HEAD + parcel.bytes.len());
    body.extend_from_slice(&[parcel.row.0, 0, 0, 0]);
    body.extend_from_slice(&parcel.piece.to_le_bytes());
    body.extend_from_slice(&parcel.pieces.to_le_bytes());
    body.extend_from_slice(&parcel.sequence.to_le_bytes());
    body.extend_from_slice(&parcel.oldest.to_le_bytes());
    body.extend_from_slice(&parcel.bytes);
    body
}

/// The message of a body; `None` when it is none.
pub fn parcel_of(body: &[u8]) -> Option<Parcel> {
    let mut reader = Reader(body);
    let row = RowId(reader.take(4)?[0]);
    let piece = u16::from_le_bytes(reader.array()?);
    let pieces = u16::from_le_bytes(reader.array()?);
    let (sequence, oldest) = (reader.u64()?, reader.u64()?);
    let is_last = piece.checked_add(1) == Some(pieces);
    let is_whole = is_last || reader.0.len() == PIECE_BYTES;
    let is_piece = piece < pieces && pieces <= PIECES_MAX && is_whole;
    (is_piece && sequence > 0 && (1..=sequence).contains(&oldest)).then(|| Parcel {
        row,
        sequence,
        oldest,
        piece,
        pieces,
        bytes: reader.0.into(),
    })
}

/// Reads numbers from bytes.
#[derive(Debug, Clone, Copy)]
pub struct Reader<'a>(pub &'a [u8]);

impl<'a> Reader<'a> {
    /// The next bytes; `None` when there are fewer.
    pub fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    /// The next bytes as an array.
    pub fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    /// The next number.
    pub fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends() -> crate::cipher::SessionKeys {
        let peer = hmac::Key::new(hmac::HMAC_SHA256, &[7; 32]);
        crate::cipher::SessionKeys::of(&peer, [[1; 16], [2; 16]])
    }

    /// Cuts, changes and lengthens a packet; each time `take` must not take it.
    fn is_taken_whole_alone(whole: &[u8], take: impl Fn(&Packet<'_>) -> bool) {
        let is_taken = |bytes: &[u8]| Packet::parse(bytes).is_some_and(|packet| take(&packet));
        assert!(is_taken(whole));
        for cut in 0..whole.len() {
            assert!(!is_taken(&whole[..cut]), "cut to {cut} bytes");
        }
        for place in 0..whole.len() {
            let mut changed = whole.to_vec();
            changed[place] ^= 1;
            assert!(!is_taken(&changed), "byte {place} changed");
        }
        assert!(!is_taken(&[whole, &[0]].concat()));
    }

    #[test]
    fn a_packet_that_is_cut_changed_or_lengthened_is_refused() {
        let cipher = ends().up;
        let whole = seal(Kind::Message, (3, 4), b"body", &cipher);
        let packet = Packet::parse(&whole).expect("a packet");
        assert_eq!((packet.session, packet.counter), (3, 4));
        assert_eq!(packet.open(&cipher), Some(b"body".to_vec()));
        is_taken_whole_alone(&whole, |packet| packet.open(&cipher).is_some());
        let key = hmac::Key::new(hmac::HMAC_SHA256, &[7; 32]);
        let hello = sign(Kind::Hello, b"body", &key);
        assert_eq!(Packet::parse(&hello).expect("a packet").greeting(), b"body");
        is_taken_whole_alone(&hello, |packet| packet.is_of(&key));
        let long = sign(Kind::Hello, &vec![0; BODY_MAX + 1], &key);
        assert!(Packet::parse(&long).is_none());
    }

    #[test]
    fn a_piece_is_one_of_its_message_and_whole_unless_it_is_the_last() {
        let is_taken = |[piece, pieces]: [u16; 2], bytes: usize| {
            let parcel = Parcel {
                row: RowId(1),
                sequence: 3,
                oldest: 2,
                piece,
                pieces,
                bytes: vec![0; bytes].into(),
            };
            let taken = parcel_of(&parcel_body(&parcel));
            assert!(taken.is_none() || taken == Some(parcel));
            taken.is_some()
        };
        let last = PIECES_MAX - 1;
        for numbers in [[0, 1], [0, 2], [1, 3], [last - 1, PIECES_MAX]] {
            assert!(is_taken(numbers, PIECE_BYTES), "{numbers:?}");
            let is_last = numbers[0] + 1 == numbers[1];
            for bytes in [0, 1, PIECE_BYTES - 1] {
                assert_eq!(is_taken(numbers, bytes), is_last, "{numbers:?}, {bytes}");
            }
        }
        assert!(is_taken([last, PIECES_MAX], 7));
        for numbers in [
            [u16::MAX, 0],
            [0, 0],
            [PIECES_MAX, PIECES_MAX],
            [0, PIECES_MAX + 1],
            [last + 1, PIECES_MAX + 1],
            [u16::MAX, u16::MAX],
        ] {
            for bytes in [0, 7, PIECE_BYTES] {
                assert!(!is_taken(numbers, bytes), "{numbers:?}, {bytes}");
            }
        }
    }

    /// A peer of another role, or a revoked one, can hear what the router passes on.
    #[test]
    fn the_body_of_a_session_is_not_readable() {
        let whole = seal(Kind::Message, (3, 4), b"a step of the car", &ends().down);
        assert!(!whole.windows(4).any(|part| part == b"step"));
        assert_eq!(
            Packet::parse(&whole).expect("a packet").open(&ends().up),
            None
        );
    }
}
