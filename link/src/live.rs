//! A session that both sides have agreed on: keys, counters, clocks.

use shm_config::Instant;

use crate::cipher::Cipher;
use crate::clock_map::{ClockMap, Shown, Stamps};
use crate::flow::{Inbox, Outbox};
use crate::packet::{Kind, Packet, Reader, parcel_body, seal};
use crate::pieces::Reached;
use crate::refusal::Reason;
use crate::role::RowId;

/// Time between two pings, ns: they also say that the sender lives.
const PING_NS: u64 = 200_000_000;
/// Without an authentic packet for this long the session is over, ns: four pings lost.
pub const SILENT_NS: u64 = 900_000_000;
/// Longest time until a message is sent again, ns.
const AGAIN_NS_MAX: u64 = 1_000_000_000;
/// What is added to the round trips before a message is sent again, ns: the acknowledgement
/// waits in two loops and for a processor.
const AGAIN_NS: u64 = 100_000_000;
/// Bytes of an acknowledgement of one row.
const ACKNOWLEDGED: usize = 16;

/// The keys of both directions, as one side uses them.
pub struct Ends {
    /// Of what this side sends.
    pub send: Cipher,
    /// Of what it receives.
    pub receive: Cipher,
}

/// A session.
pub struct Live {
    /// Its number.
    pub session: u64,
    ends: Ends,
    sent: u64,
    /// The highest counter that came: each counts once, and none before it any more.
    seen: u64,
    /// When the last authentic packet came.
    pub heard: Instant,
    pinged: Option<Instant>,
    /// The other clock.
    pub clock: ClockMap,
}

/// What an authentic packet holds for the side that received it.
#[derive(Debug)]
pub enum Content {
    /// A message of a row, not taken apart.
    Message(Vec<u8>),
    /// Nothing that it has to do.
    Done,
    /// The other clock has jumped by this, ns.
    Jumped(i64),
    /// The other side ends the session.
    Bye,
    /// To be sent.
    Answer(Vec<u8>),
}

impl Live {
    /// A session that begins.
    pub fn new(session: u64, ends: Ends, now: Instant) -> Self {
        Self {
            session,
            ends,
            sent: 0,
            seen: 0,
            heard: now,
            pinged: None,
            clock: ClockMap::default(),
        }
    }

    /// Makes the next packet.
    pub fn seal(&mut self, kind: Kind, body: &[u8]) -> Vec<u8> {
        self.sent += 1;
        seal(kind, (self.session, self.sent), body, &self.ends.send)
    }

    /// Decrypts a packet of this connection and gives its body. A packet that was changed, or
    /// whose counter is not above that of the last one, is refused.
    ///
    /// # Errors
    /// Why it is refused.
    pub fn open(&mut self, packet: &Packet<'_>, now: Instant) -> Result<Vec<u8>, Reason> {
        let body = packet.open(&self.ends.receive).ok_or(Reason::Forged)?;
        if packet.counter <= self.seen {
            return Err(Reason::Replayed);
        }
        self.seen = packet.counter;
        self.heard = now;
        Ok(body)
    }

    /// Carries out what an authentic packet says, but for messages.
    ///
    /// # Errors
    /// When its body is not one of its kind.
    pub fn carry_out(
        &mut self,
        (kind, body): (Kind, Vec<u8>),
        outbox: &mut Outbox,
        (came, now): (Instant, Instant),
    ) -> Result<Content, Reason> {
        match kind {
            Kind::Message => Ok(Content::Message(body)),
            Kind::Bye => Ok(Content::Bye),
            Kind::Acknowledgement => {
                if !body.len().is_multiple_of(ACKNOWLEDGED) {
                    return Err(Reason::Malformed);
                }
                for entry in body.chunks(ACKNOWLEDGED) {
                    let mut reader = Reader(entry);
                    let row = reader.take(4).map(|bytes| RowId(bytes[0]));
                    let pieces = reader.array().map(u16::from_le_bytes);
                    let sequence = reader.take(2).and_then(|_| reader.u64());
                    if let (Some(row), Some(pieces), Some(sequence)) = (row, pieces, sequence) {
                        let reached = Reached { sequence, pieces };
                        outbox.acknowledge(row, reached, now);
                    }
                }
                Ok(Content::Done)
            }
            Kind::Ping => {
                let t1 = Reader(&body).u64().ok_or(Reason::Malformed)?;
                let mut answer = t1.to_le_bytes().to_vec();
                answer.extend_from_slice(&came.0.to_le_bytes());
                // A packet may come after the turn has read the clock.
                answer.extend_from_slice(&now.max(came).0.to_le_bytes());
                Ok(Content::Answer(self.seal(Kind::Pong, &answer)))
            }
            Kind::Pong => {
                let mut reader = Reader(&body);
                let mut next = || reader.u64().ok_or(Reason::Malformed);
                let stamps = Stamps {
                    t1: next()?,
                    t2: next()?,
                    t3: next()?,
                    t4: came.0,
                };
                match self.clock.take(stamps) {
                    Shown::Jumped(by_ns) => Ok(Content::Jumped(by_ns)),
                    Shown::Impossible => Err(Reason::Content),
                    Shown::Agrees | Shown::Doubtful => Ok(Content::Done),
                }
            }
            Kind::Hello | Kind::Welcome | Kind::Refusal => Err(Reason::Malformed),
        }
    }

    /// Makes the packets that are due: messages, acknowledgements, a ping.
    pub fn due(
        &mut self,
        (outbox, inbox): (&mut Outbox, &mut Inbox),
        now: Instant,
        give: &mut dyn FnMut(Vec<u8>),
    ) {
        let mut acknowledged = Vec::new();
        inbox.acknowledge(|row, Reached { sequence, pieces }| {
            acknowledged.extend_from_slice(&[row.0, 0, 0, 0]);
            acknowledged.extend_from_slice(&u64::from(pieces).to_le_bytes()[..4]);
            acknowledged.extend_from_slice(&sequence.to_le_bytes());
        });
        if !acknowledged.is_empty() {
            give(self.seal(Kind::Acknowledgement, &acknowledged));
        }
        let round_trip_ns = self.clock.mapped(now.0).map_or(0, |map| map.round_trip_ns);
        let wait_ns = (3 * round_trip_ns + AGAIN_NS).min(AGAIN_NS_MAX);
        outbox.due(now, wait_ns, &mut |parcel| {
            give(self.seal(Kind::Message, &parcel_body(&parcel)));
        });
        if self.pinged.is_none_or(|last| now.since_ns(last) >= PING_NS) {
            self.pinged = Some(now);
            give(self.seal(Kind::Ping, &now.0.to_le_bytes()));
        }
    }

    /// Whether the other side has been silent for too long.
    pub fn is_silent(&self, now: Instant) -> bool {
        now.since_ns(self.heard) > SILENT_NS
    }
}
