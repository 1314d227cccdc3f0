//! What travels: the bytes of a packet.
//!
//! | part | bytes |
//! |---|---|
//! | `VLNK`, kind, three zeros | 8 |
//! | session | 8 |
//! | counter, from 1 in each session and direction | 8 |
//! | body | up to [`BODY_MAX`] |
//! | HMAC-SHA256 of all before it | 32 |
//!
//! All numbers are little-endian.

use ring::hmac;

use crate::flow::Parcel;
use crate::role::RowId;

/// The first bytes.
const MAGIC: &[u8; 4] = b"VLNK";
/// Bytes before the body.
const HEAD: usize = 24;
/// Bytes behind it.
const TAG: usize = 32;
/// Most bytes of a body: the largest policy file and what is with it.
pub const BODY_MAX: usize = (8 << 20) + (64 << 10);
/// Bytes of a parcel before its message.
const PARCEL_HEAD: usize = 24;

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

/// A packet, taken apart; nothing of it is trusted yet.
#[derive(Debug, Clone, Copy)]
pub struct Packet<'a> {
    /// What it is.
    pub kind: Kind,
    /// Its session.
    pub session: u64,
    /// Its number in the session.
    pub counter: u64,
    /// Its content.
    pub body: &'a [u8],
    signed: &'a [u8],
    tag: &'a [u8],
}

impl<'a> Packet<'a> {
    /// Takes bytes apart; `None` when they are no packet.
    pub fn parse(bytes: &'a [u8]) -> Option<Self> {
        if bytes.len() < HEAD + TAG || bytes.len() > HEAD + BODY_MAX + TAG {
            return None;
        }
        let (signed, tag) = bytes.split_at(bytes.len() - TAG);
        let mut reader = Reader(signed);
        let [magic, kind, zeros] = [reader.take(4)?, reader.take(1)?, reader.take(3)?];
        if magic != MAGIC || zeros != [0; 3] {
            return None;
        }
        Some(Self {
            kind: Kind::from_code(u32::from(kind[0]))?,
            session: reader.u64()?,
            counter: reader.u64()?,
            body: reader.0,
            signed,
            tag,
        })
    }

    /// Whether it was made with this key, and not changed since.
    pub fn is_of(&self, key: &hmac::Key) -> bool {
        hmac::verify(key, self.signed, self.tag).is_ok()
    }
}

/// Makes a packet.
pub fn seal(kind: Kind, (session, counter): (u64, u64), body: &[u8], key: &hmac::Key) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEAD + body.len() + TAG);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&[kind.code() as u8, 0, 0, 0]);
    bytes.extend_from_slice(&session.to_le_bytes());
    bytes.extend_from_slice(&counter.to_le_bytes());
    bytes.extend_from_slice(body);
    let tag = hmac::sign(key, &bytes);
    bytes.extend_from_slice(tag.as_ref());
    bytes
}

/// The body of a message.
pub fn parcel_body(parcel: &Parcel) -> Vec<u8> {
    let mut body = Vec::with_capacity(PARCEL_HEAD + parcel.bytes.len());
    body.extend_from_slice(&[parcel.row.0, 0, 0, 0, 0, 0, 0, 0]);
    body.extend_from_slice(&parcel.sequence.to_le_bytes());
    body.extend_from_slice(&parcel.oldest.to_le_bytes());
    body.extend_from_slice(&parcel.bytes);
    body
}

/// The message of a body; `None` when it is none.
pub fn parcel_of(body: &[u8]) -> Option<Parcel> {
    let mut reader = Reader(body);
    let row = RowId(reader.take(8)?[0]);
    let (sequence, oldest) = (reader.u64()?, reader.u64()?);
    (sequence > 0 && (1..=sequence).contains(&oldest)).then(|| Parcel {
        row,
        sequence,
        oldest,
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

    #[test]
    fn a_packet_that_is_cut_changed_or_lengthened_is_refused() {
        let key = hmac::Key::new(hmac::HMAC_SHA256, &[7; 32]);
        let whole = seal(Kind::Message, (3, 4), b"body", &key);
        let packet = Packet::parse(&whole).expect("a packet");
        assert_eq!(
            (packet.session, packet.counter, packet.body),
            (3, 4, &b"body"[..])
        );
        assert!(packet.is_of(&key));
        for cut in 0..whole.len() {
            let is_taken = Packet::parse(&whole[..cut]).is_some_and(|packet| packet.is_of(&key));
            assert!(!is_taken, "cut to {cut} bytes");
        }
        for place in 0..whole.len() {
            let mut changed = whole.clone();
            changed[place] ^= 1;
            let is_taken = Packet::parse(&changed).is_some_and(|packet| packet.is_of(&key));
            assert!(!is_taken, "byte {place} changed");
        }
        let mut longer = whole.clone();
        longer.push(0);
        assert!(!Packet::parse(&longer).is_some_and(|packet| packet.is_of(&key)));
        assert!(Packet::parse(&vec![0; HEAD + BODY_MAX + TAG + 1]).is_none());
    }
}
