//! The side that joins: one session with the vehicle, begun again when it is lost.

use std::io;
use std::sync::Arc;

use ring::hmac;
use shm_config::Instant;

use crate::cipher::SessionKeys;
use crate::flow::{Inbox, Outbox};
use crate::hello::{Hello, Welcome};
use crate::host::no_key;
use crate::keys::{Bundle, Claim, random};
use crate::live::{Content, Ends, Live};
use crate::packet::{Kind, Packet, Reader, parcel_of, sign};
use crate::refusal::{Reason, Refused};
use crate::role::{Passage, RowId, layouts};

/// Time between two hellos, ns.
const HELLO_NS: u64 = 250_000_000;

/// What has happened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum News {
    /// A session has begun; whether the vehicle's process is another than before.
    Joined(Vehicle),
    /// The session is over.
    Lost(&'static str),
    /// A message of a row.
    Message(RowId, Arc<[u8]>),
    /// The vehicle refuses.
    Refused(Reason),
    /// The vehicle's clock has jumped by this, ns.
    Jumped(i64),
}

/// Which process of the vehicle answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Vehicle {
    /// The same as before.
    Same,
    /// The first, or one that was started since.
    New,
}

/// The side that joins.
pub struct Peer {
    claim: Claim,
    key: hmac::Key,
    layouts: u64,
    instance: u64,
    /// The random number of the hello that waits for its answer. It counts for one session:
    /// a second one with it would have the same keys.
    nonce: Option<[u8; 16]>,
    greeted: Option<Instant>,
    vehicle: Option<u64>,
    /// What the vehicle is to receive.
    pub outbox: Outbox,
    /// What came from it.
    pub inbox: Inbox,
    /// The session.
    pub live: Option<Live>,
    /// Sessions begun.
    pub joins: u64,
    /// What was refused of the vehicle's packets.
    pub refused: Refused,
    out: Vec<Vec<u8>>,
    news: Vec<News>,
}

impl Peer {
    /// A peer with this invitation.
    ///
    /// # Errors
    /// When it is damaged, or the system has no random numbers.
    pub fn new(bundle: &Bundle) -> io::Result<Self> {
        Ok(Self {
            claim: bundle.claim()?,
            key: bundle.key(),
            layouts: layouts(),
            instance: u64::from_le_bytes(random()?),
            nonce: None,
            greeted: None,
            vehicle: None,
            outbox: Outbox::default(),
            inbox: Inbox::default(),
            live: None,
            joins: 0,
            refused: Refused::default(),
            out: Vec::new(),
            news: Vec::new(),
        })
    }

    /// Its invitation.
    pub fn claim(&self) -> &Claim {
        &self.claim
    }

    /// The packets that are to be sent.
    pub fn take_out(&mut self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.out)
    }

    /// What has happened since the last call.
    pub fn take_news(&mut self) -> Vec<News> {
        std::mem::take(&mut self.news)
    }

    /// Sends a message.
    pub fn push(&mut self, row: RowId, bytes: Arc<[u8]>) {
        self.outbox.push(row, Passage::Newest, bytes);
    }

    /// Takes a packet that came at an instant.
    pub fn receive(&mut self, bytes: &[u8], (came, now): (Instant, Instant)) {
        let taken = match Packet::parse(bytes) {
            None => Err(Reason::Malformed),
            Some(packet) => match packet.kind {
                Kind::Welcome => self.begin(&packet, now),
                Kind::Refusal => self.refusal(&packet),
                _ => self.take(&packet, (came, now)),
            },
        };
        if let Err(reason) = taken {
            self.refused.count(reason);
        }
    }

    fn begin(&mut self, packet: &Packet<'_>, now: Instant) -> Result<(), Reason> {
        let welcome = Welcome::of(packet.greeting()).ok_or(Reason::Malformed)?;
        if !packet.is_of(&self.key) {
            return Err(Reason::Forged);
        }
        // An answer to another hello; the newest one counts.
        if self.nonce != Some(welcome.nonce) || self.live.is_some() {
            return Err(Reason::Replayed);
        }
        self.nonce = None;
        let keys = SessionKeys::of(&self.key, [welcome.nonce, welcome.own_nonce]);
        let ends = Ends {
            send: keys.up,
            receive: keys.down,
        };
        self.live = Some(Live::new(welcome.session(), ends, now));
        self.joins += 1;
        self.outbox.begin_again();
        let is_same = self.vehicle.replace(welcome.instance) == Some(welcome.instance);
        self.news.push(News::Joined(match is_same {
            true => Vehicle::Same,
            false => {
                self.inbox = Inbox::default();
                Vehicle::New
            }
        }));
        Ok(())
    }

    fn refusal(&mut self, packet: &Packet<'_>) -> Result<(), Reason> {
        let mut reader = Reader(packet.greeting());
        let (nonce, code) = (reader.array(), reader.array().map(u32::from_le_bytes));
        let is_answer = nonce.is_some() && nonce == self.nonce;
        let reason = code.and_then(Reason::from_code).ok_or(Reason::Malformed)?;
        match is_answer && packet.is_of(&no_key()) {
            true => {
                self.news.push(News::Refused(reason));
                Ok(())
            }
            false => Err(Reason::Replayed),
        }
    }

    fn take(&mut self, packet: &Packet<'_>, (came, now): (Instant, Instant)) -> Result<(), Reason> {
        let live = self.live.as_mut().ok_or(Reason::NoSession)?;
        if live.session != packet.session {
            return Err(Reason::NoSession);
        }
        let body = live.open(packet, now)?;
        match live.carry_out((packet.kind, body), &mut self.outbox, (came, now))? {
            Content::Done => {}
            Content::Answer(bytes) => self.out.push(bytes),
            Content::Jumped(by_ns) => self.news.push(News::Jumped(by_ns)),
            Content::Bye => self.lose("the vehicle has ended it"),
            Content::Message(body) => {
                let parcel = parcel_of(&body).ok_or(Reason::Malformed)?;
                let row = parcel.row;
                if !self.claim.role.hears(row) {
                    return Err(Reason::NotAllowed);
                }
                let news = &mut self.news;
                self.inbox
                    .take(parcel, row.passage(self.claim.role), &mut |parcel| {
                        news.push(News::Message(row, parcel.bytes));
                    });
            }
        }
        Ok(())
    }

    fn lose(&mut self, why: &'static str) {
        self.live = None;
        self.greeted = None;
        self.news.push(News::Lost(why));
    }

    /// Makes the packets that are due; without a session a hello.
    pub fn poll(&mut self, now: Instant) {
        if self.live.as_ref().is_some_and(|live| live.is_silent(now)) {
            self.lose("the vehicle is silent");
        }
        let out = &mut self.out;
        match &mut self.live {
            Some(live) => live.due((&mut self.outbox, &mut self.inbox), now, &mut |bytes| {
                out.push(bytes);
            }),
            None => self.greet(now),
        }
    }

    fn greet(&mut self, now: Instant) {
        if self
            .greeted
            .is_some_and(|last| now.since_ns(last) < HELLO_NS)
        {
            return;
        }
        // Without random numbers there is no hello; the next turn tries again.
        let Some(nonce) = self.nonce.or_else(|| random().ok()) else {
            return;
        };
        self.nonce = Some(nonce);
        self.greeted = Some(now);
        let hello = Hello {
            claim: self.claim,
            layouts: self.layouts,
            nonce,
            instance: self.instance,
        };
        self.out.push(sign(Kind::Hello, &hello.body(), &self.key));
    }

    /// Ends the session.
    pub fn end(&mut self) {
        if let Some(mut live) = self.live.take() {
            self.out.push(live.seal(Kind::Bye, &[]));
        }
    }

    /// Pretends other message layouts, for tests of the vehicle's door.
    #[doc(hidden)]
    pub fn set_layouts(&mut self, layouts: u64) {
        self.layouts = layouts;
    }
}
