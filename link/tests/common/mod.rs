//! What the tests share: one set of keys, and a line between both ends.

#![allow(dead_code)] // each test program uses a part

use std::collections::VecDeque;
use std::sync::OnceLock;

use shm_config::Instant;
use vlaps_link::host::{Event, Host};
use vlaps_link::keys::{Bundle, RunKeys};
use vlaps_link::peer::{News, Peer};
use vlaps_link::role::Role;

/// Nanoseconds.
pub const MS: u64 = 1_000_000;
/// The end of the invitations, s since 1970.
pub const END_EPOCH_S: u64 = 4_000_000_000;

/// The keys of one run, the same at each call.
pub fn keys() -> RunKeys {
    static TEXT: OnceLock<String> = OnceLock::new();
    let text = TEXT.get_or_init(|| {
        let keys = RunKeys::make("drive").expect("keys");
        serde_json::to_string(&keys).expect("a text")
    });
    serde_json::from_str(text).expect("keys")
}

/// An invitation.
pub fn bundle(keys: &RunKeys, role: Role) -> Bundle {
    keys.invite(role, "127.0.0.1:7450", END_EPOCH_S)
        .expect("an invitation")
}

/// Both ends and what lies between them.
pub struct Line {
    /// The vehicle.
    pub host: Host,
    /// The other machine.
    pub peer: Peer,
    /// The clock of both.
    pub now: Instant,
    /// The date.
    pub epoch_s: u64,
    /// A packet takes this long, ms.
    pub delay_ms: u64,
    to_host: VecDeque<(Instant, Vec<u8>)>,
    to_peer: VecDeque<(Instant, Vec<u8>)>,
    /// Nothing arrives.
    pub is_cut: bool,
    /// Every packet that went to the vehicle.
    pub tape: Option<Vec<Vec<u8>>>,
    /// What has happened.
    pub events: Vec<Event>,
    /// The same of the peer.
    pub news: Vec<News>,
}

impl Line {
    /// Begins a second after the start of the clock.
    pub fn new(host: Host, peer: Peer) -> Self {
        Self {
            host,
            peer,
            now: Instant(1_000 * MS),
            epoch_s: 1,
            delay_ms: 0,
            to_host: VecDeque::new(),
            to_peer: VecDeque::new(),
            is_cut: false,
            tape: None,
            events: Vec::new(),
            news: Vec::new(),
        }
    }

    /// Passes packets for some milliseconds.
    pub fn run(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now = self.now.after_ns(MS);
            let now = self.now;
            let arrives = now.after_ns(self.delay_ms * MS);
            self.peer.poll(now);
            for bytes in self.peer.take_out() {
                if let Some(tape) = &mut self.tape {
                    tape.push(bytes.clone());
                }
                if !self.is_cut {
                    self.to_host.push_back((arrives, bytes));
                }
            }
            while let Some((_, bytes)) = self.to_host.pop_front_if(|(at, _)| *at <= now) {
                self.host.receive(&bytes, (now, now), self.epoch_s);
            }
            self.host.poll(now, self.epoch_s);
            for (_, peer, bytes) in self.host.take_out() {
                if !self.is_cut && peer == self.peer.claim().peer {
                    self.to_peer.push_back((arrives, bytes));
                }
            }
            while let Some((_, bytes)) = self.to_peer.pop_front_if(|(at, _)| *at <= now) {
                self.peer.receive(&bytes, (now, now));
            }
            self.events.extend(self.host.take_events());
            self.news.extend(self.peer.take_news());
        }
    }
}
