//! The vehicle's side: which peers there are, and the door that all of their packets pass.
//!
//! It has no network and no clock of its own: packets go in, packets and events come out.
//!
//! A recorded hello that is sent again opens a session for nothing: it replaces the session
//! that lives only when a packet with the new session's key follows.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::sync::Arc;

use ring::hmac;
use shm_config::Instant;

use crate::cipher::SessionKeys;
use crate::flow::{Inbox, Outbox, QUEUE_MAX};
use crate::hello::{Hello, Welcome};
use crate::keys::{Claim, Identity, RunKeys, random};
use crate::live::{Content, Ends, Live};
use crate::packet::{Kind, Packet, parcel_of, sign};
use crate::refusal::{Reason, Refused};
use crate::role::{Passage, Role, RowId, layouts};

/// Peers that are known at a time. One that is gone is forgotten for a new one.
const PEERS_MAX: usize = 16;

/// Which peers a door is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Seats {
    /// One peer of this role: it stands in the place of a process.
    One(Role),
    /// Any number of peers that only read.
    Readers,
}

impl Seats {
    fn admits(self, role: Role) -> bool {
        match self {
            Self::One(own) => role == own,
            Self::Readers => role.stands_for().is_none(),
        }
    }
}

/// What has happened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// A peer has begun a session.
    Joined(Claim),
    /// A session is over.
    Left(Claim, &'static str),
    /// A message of a row that the peer may send.
    Message(Claim, RowId, Arc<[u8]>),
    /// The peer's clock has jumped by this, ns.
    Jumped(Claim, i64),
    /// Why no invitation has an effect now; `None` when they have again.
    Closed(Option<&'static str>),
}

/// One peer.
pub struct Guest {
    /// Its invitation.
    pub claim: Claim,
    /// What it is to receive.
    pub outbox: Outbox,
    /// What came from it.
    pub inbox: Inbox,
    /// Its session.
    pub live: Option<Live>,
    /// Sessions that it has begun.
    pub joins: u64,
    key: hmac::Key,
    instance: Option<u64>,
    offered: Option<Offer>,
}

/// A session that is offered to a peer, and begins with its first packet.
struct Offer {
    live: Live,
    /// The random numbers of the hello and of the process that asked.
    nonce: [u8; 16],
    instance: u64,
    answer: Vec<u8>,
}

/// The vehicle's side.
pub struct Host {
    keys: RunKeys,
    seats: Seats,
    /// Why no invitation has an effect.
    closed: Option<&'static str>,
    instance: u64,
    guests: BTreeMap<Identity, Guest>,
    /// The newest message of each row, and of rows of every message those that were sent
    /// before the first peer came.
    kept: BTreeMap<RowId, VecDeque<Arc<[u8]>>>,
    out: Vec<(Role, Identity, Vec<u8>)>,
    events: Vec<Event>,
    /// What was refused.
    pub refused: Refused,
}

impl Host {
    /// A door for these peers.
    ///
    /// # Errors
    /// When the system has no random numbers.
    pub fn new(keys: RunKeys, seats: Seats) -> io::Result<Self> {
        Ok(Self {
            keys,
            seats,
            closed: None,
            instance: u64::from_le_bytes(random()?),
            guests: BTreeMap::new(),
            kept: BTreeMap::new(),
            out: Vec::new(),
            events: Vec::new(),
            refused: Refused::default(),
        })
    }

    /// The peers.
    pub fn guests(&self) -> impl Iterator<Item = &Guest> {
        self.guests.values()
    }

    /// Ends the effect of these invitations, for as long as this process lives.
    pub fn revoke(&mut self, revoked: Vec<Identity>) {
        for peer in revoked {
            if !self.keys.revoked.contains(&peer) {
                self.keys.revoked.push(peer);
            }
        }
    }

    /// Takes the list of revoked invitations from the keys as they are now. Without the keys
    /// of this run nothing is known of revocations: then no invitation has an effect.
    pub fn renew(&mut self, read: io::Result<Option<RunKeys>>) {
        let closed = match read {
            Ok(Some(keys)) if keys.identity == self.keys.identity => {
                self.revoke(keys.revoked);
                None
            }
            Ok(Some(_)) => Some("the file of the run's keys has those of another run"),
            Ok(None) => Some("the file of the run's keys is gone"),
            Err(_) => Some("the file of the run's keys cannot be read"),
        };
        if closed != self.closed {
            self.closed = closed;
            self.events.push(Event::Closed(closed));
        }
    }

    fn is_revoked(&self, peer: Identity) -> bool {
        self.closed.is_some() || self.keys.revoked.contains(&peer)
    }

    /// The packets that are to be sent, each to its peer.
    pub fn take_out(&mut self) -> Vec<(Role, Identity, Vec<u8>)> {
        std::mem::take(&mut self.out)
    }

    /// What has happened since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Sends a message to each peer whose role hears its row.
    pub fn push(&mut self, row: RowId, bytes: Arc<[u8]>) {
        for guest in self.guests.values_mut() {
            let role = guest.claim.role;
            if role.hears(row) {
                guest.outbox.push(row, row.passage(role), bytes.clone());
            }
        }
        let role = match self.seats {
            Seats::One(role) => role,
            Seats::Readers => Role::View,
        };
        let kept = self.kept.entry(row).or_default();
        match row.passage(role) {
            Passage::Newest => kept.clear(),
            // Those who only read begin with what is sent from now on.
            Passage::Every if self.seats == Seats::Readers || !self.guests.is_empty() => {
                kept.clear();
                return;
            }
            Passage::Every if kept.len() == QUEUE_MAX => drop(kept.pop_front()),
            Passage::Every => {}
        }
        kept.push_back(bytes);
    }

    /// Takes a packet that came at an instant.
    pub fn receive(&mut self, bytes: &[u8], (came, now): (Instant, Instant), epoch_s: u64) {
        let taken = match Packet::parse(bytes) {
            None => Err(Reason::Malformed),
            Some(packet) if packet.kind == Kind::Hello => self.greet(&packet, now, epoch_s),
            Some(packet) => self.take(&packet, (came, now)),
        };
        if let Err(reason) = taken {
            self.refused.count(reason);
        }
    }

    fn greet(&mut self, packet: &Packet<'_>, now: Instant, epoch_s: u64) -> Result<(), Reason> {
        let hello = Hello::of(packet.greeting()).ok_or(Reason::Malformed)?;
        let peer = hello.claim.peer;
        match self.admit(&hello, packet, (now, epoch_s)) {
            Ok(key) => self.offer(&hello, key, now),
            Err(reason) => {
                let mut body = hello.nonce.to_vec();
                body.extend_from_slice(&reason.code().to_le_bytes());
                self.out.push((
                    hello.claim.role,
                    peer,
                    sign(Kind::Refusal, &body, &no_key()),
                ));
                Err(reason)
            }
        }
    }

    /// The door of a hello: the key first, because nothing else that it says is known to be
    /// true before.
    fn admit(
        &self,
        hello: &Hello,
        packet: &Packet<'_>,
        (now, epoch_s): (Instant, u64),
    ) -> Result<hmac::Key, Reason> {
        let claim = &hello.claim;
        if claim.run != self.keys.identity {
            return Err(Reason::OtherRun);
        }
        let key = self.keys.peer_key(claim);
        if !packet.is_of(&key) {
            return Err(Reason::WrongKey);
        }
        let others = || {
            self.guests
                .values()
                .filter(|guest| guest.claim.peer != claim.peer)
        };
        let lives = |guest: &Guest| guest.live.as_ref().is_some_and(|live| !live.is_silent(now));
        let has_seat = match self.seats {
            Seats::One(_) => !others().any(lives),
            Seats::Readers => others().filter(|guest| lives(guest)).count() < PEERS_MAX - 1,
        };
        // An invitation is for one process; another one waits until the first is silent.
        let has_twin = self
            .guests
            .get(&claim.peer)
            .is_some_and(|guest| lives(guest) && guest.instance != Some(hello.instance));
        match () {
            () if hello.layouts != layouts() => Err(Reason::OtherLayout),
            () if !self.seats.admits(claim.role) => Err(Reason::WrongRole),
            () if epoch_s >= claim.expires_epoch_s => Err(Reason::Expired),
            () if self.is_revoked(claim.peer) => Err(Reason::Revoked),
            () if !has_seat || has_twin => Err(Reason::Occupied),
            () => Ok(key),
        }
    }

    fn offer(&mut self, hello: &Hello, key: hmac::Key, now: Instant) -> Result<(), Reason> {
        let claim = hello.claim;
        // The hello came again because the answer is slow: it gets the same answer, so that
        // the session exists which the peer begins with the first one.
        let offered = self
            .guests
            .get(&claim.peer)
            .and_then(|guest| guest.offered.as_ref());
        if let Some(offer) = offered.filter(|offer| offer.nonce == hello.nonce) {
            self.out
                .push((claim.role, claim.peer, offer.answer.clone()));
            return Ok(());
        }
        // Without random numbers there is no session; the peer asks again.
        let own_nonce = random().map_err(|_| Reason::NoSession)?;
        let welcome = Welcome {
            nonce: hello.nonce,
            own_nonce,
            instance: self.instance,
        };
        let keys = SessionKeys::of(&key, [hello.nonce, own_nonce]);
        let ends = Ends {
            send: keys.down,
            receive: keys.up,
        };
        if !self.guests.contains_key(&claim.peer) {
            self.make_place();
            let mut outbox = Outbox::default();
            for (row, messages) in &mut self.kept {
                let passage = row.passage(claim.role);
                if !claim.role.hears(*row) {
                    continue;
                }
                for bytes in messages.iter().filter(|_| passage == Passage::Every) {
                    outbox.push(*row, passage, bytes.clone());
                }
                if passage == Passage::Every {
                    messages.clear();
                }
            }
            let guest = Guest {
                claim,
                key: key.clone(),
                instance: None,
                outbox,
                inbox: Inbox::default(),
                live: None,
                joins: 0,
                offered: None,
            };
            self.guests.insert(claim.peer, guest);
        }
        let Some(guest) = self.guests.get_mut(&claim.peer) else {
            return Ok(());
        };
        // A later invitation cannot have the same identity, but another end or signer.
        (guest.claim, guest.key) = (claim, key);
        let answer = sign(Kind::Welcome, &welcome.body(), &guest.key);
        guest.offered = Some(Offer {
            live: Live::new(welcome.session(), ends, now),
            nonce: hello.nonce,
            instance: hello.instance,
            answer: answer.clone(),
        });
        self.out.push((claim.role, claim.peer, answer));
        Ok(())
    }

    /// Forgets a peer without a session when there are too many.
    fn make_place(&mut self) {
        if self.guests.len() < PEERS_MAX {
            return;
        }
        let gone = self.guests.iter().find(|(_, guest)| guest.live.is_none());
        if let Some(peer) = gone.map(|(peer, _)| *peer) {
            self.guests.remove(&peer);
        }
    }

    fn take(&mut self, packet: &Packet<'_>, (came, now): (Instant, Instant)) -> Result<(), Reason> {
        let is_of = |live: &Live| live.session == packet.session;
        let guest = self.guests.values_mut().find(|guest| {
            guest.live.as_ref().is_some_and(is_of)
                || guest
                    .offered
                    .as_ref()
                    .is_some_and(|offer| is_of(&offer.live))
        });
        let guest = guest.ok_or(Reason::NoSession)?;
        let claim = guest.claim;
        let mut body = Vec::new();
        if let Some(offer) = guest.offered.as_mut()
            && is_of(&offer.live)
        {
            body = offer.live.open(packet, now)?;
            let instance = offer.instance;
            guest.live = guest.offered.take().map(|offer| offer.live);
            guest.joins += 1;
            guest.outbox.begin_again();
            if guest.instance.replace(instance) != Some(instance) {
                guest.inbox = Inbox::default();
                for (row, messages) in &self.kept {
                    let is_newest = row.passage(claim.role) == Passage::Newest;
                    if let (true, true, Some(bytes)) =
                        (is_newest, claim.role.hears(*row), messages.back())
                    {
                        guest.outbox.push(*row, Passage::Newest, bytes.clone());
                    }
                }
            }
            self.events.push(Event::Joined(claim));
        } else if let Some(live) = &mut guest.live {
            body = live.open(packet, now)?;
        }
        let Some(live) = &mut guest.live else {
            return Ok(());
        };
        match live.carry_out((packet.kind, body), &mut guest.outbox, (came, now))? {
            Content::Done => {}
            Content::Answer(bytes) => self.out.push((claim.role, claim.peer, bytes)),
            Content::Jumped(by_ns) => self.events.push(Event::Jumped(claim, by_ns)),
            Content::Bye => {
                guest.live = None;
                self.events.push(Event::Left(claim, "it has ended"));
            }
            Content::Message(body) => {
                let parcel = parcel_of(&body).ok_or(Reason::Malformed)?;
                let row = parcel.row;
                if !claim.role.may_send(row) {
                    return Err(Reason::NotAllowed);
                }
                let events = &mut self.events;
                guest
                    .inbox
                    .take(parcel, row.passage(claim.role), &mut |parcel| {
                        events.push(Event::Message(claim, row, parcel.bytes));
                    });
            }
        }
        Ok(())
    }

    /// Makes the packets that are due, and ends sessions that are over.
    pub fn poll(&mut self, now: Instant, epoch_s: u64) {
        for guest in self.guests.values_mut() {
            let claim = guest.claim;
            let Some(live) = &mut guest.live else {
                continue;
            };
            let over = match () {
                () if epoch_s >= claim.expires_epoch_s => Some("its invitation has ended"),
                () if self.keys.revoked.contains(&claim.peer) => Some("its invitation was revoked"),
                () if self.closed.is_some() => self.closed,
                () if live.is_silent(now) => Some("it is silent"),
                () => None,
            };
            if let Some(why) = over {
                guest.live = None;
                self.events.push(Event::Left(claim, why));
                continue;
            }
            let out = &mut self.out;
            live.due((&mut guest.outbox, &mut guest.inbox), now, &mut |bytes| {
                out.push((claim.role, claim.peer, bytes));
            });
        }
    }

    /// Tells each peer that the run has ended.
    pub fn end(&mut self) {
        for guest in self.guests.values_mut() {
            if let Some(mut live) = guest.live.take() {
                let bytes = live.seal(Kind::Bye, &[]);
                self.out.push((guest.claim.role, guest.claim.peer, bytes));
            }
        }
    }
}

/// The key of a refusal, which everyone has.
pub fn no_key() -> hmac::Key {
    hmac::Key::new(hmac::HMAC_SHA256, &[0; 32])
}
