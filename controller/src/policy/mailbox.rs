//! The single-slot mailbox between the loader's thread and the tick's.
//!
//! Its lock is held for moving a few pointers. The tick's end only tries the lock,
//! between two ticks, and tries again later when it is taken: it never waits, and
//! never allocates or frees.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use super::{Fault, Policy, StartStage};

/// Policies and events on their way to the loader at a time. One outcome of a canary
/// returns at most two policies and one event; the tick's end adopts nothing new
/// before they are gone.
const RETURNS_MAX: usize = 8;

/// A checked, built and warmed policy.
pub struct Candidate {
    /// The policy.
    pub policy: Box<dyn Policy>,
    /// How it begins.
    pub start: StartStage,
}

/// What became of a candidate, for the loader.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SwapEvent {
    /// This version was adopted.
    Adopted {
        /// The version.
        version: u64,
        /// Before this tick.
        tick: u64,
    },
    /// It may drive.
    Promoted {
        /// The version.
        version: u64,
        /// From this tick on.
        tick: u64,
    },
    /// It was rolled back.
    RolledBack {
        /// The version.
        version: u64,
        /// From this tick on.
        tick: u64,
        /// Why.
        fault: Fault,
        /// Version and hash of the active weights; zeros for none.
        active: (u64, u64),
    },
}

/// What is in the mailbox.
#[derive(Default)]
pub struct Contents {
    /// For the tick.
    pub candidate: Option<Candidate>,
    /// For the loader, to be dropped.
    pub returned: [Option<Box<dyn Policy>>; RETURNS_MAX],
    /// For the loader, in order.
    pub events: [Option<SwapEvent>; RETURNS_MAX],
    /// The number of the first tick of this controller; `None` before it.
    pub first_tick: Option<u64>,
}

/// The mailbox, and up to which version the loader has decided.
#[derive(Default)]
pub struct Mailbox {
    /// Its contents.
    pub contents: Mutex<Contents>,
    decided: AtomicU64,
}

impl Mailbox {
    /// Up to this version, every offer is refused or is in the mailbox.
    pub fn decided(&self) -> u64 {
        self.decided.load(Ordering::Acquire)
    }

    /// The loader has decided.
    pub fn decide(&self, version: u64) {
        self.decided.fetch_max(version, Ordering::Release);
    }
}

/// The tick's end of the mailbox.
#[derive(Default)]
pub struct TickEnd {
    returned: [Option<Box<dyn Policy>>; RETURNS_MAX],
    events: [Option<SwapEvent>; RETURNS_MAX],
    first_tick: Option<u64>,
}

/// What an exchange with the mailbox brought.
pub enum Exchanged {
    /// The mailbox is locked: try again later.
    Locked,
    /// Events and policies are delivered; the candidate for the tick, if any.
    Done(Option<Candidate>),
}

impl TickEnd {
    /// Delivers returned policies and events, and takes the candidate. Never waits.
    pub fn exchange(&mut self, mailbox: &Mailbox) -> Exchanged {
        let Ok(mut contents) = mailbox.contents.try_lock() else {
            return Exchanged::Locked;
        };
        move_over(&mut self.returned, &mut contents.returned);
        move_over(&mut self.events, &mut contents.events);
        contents.first_tick = self.first_tick;
        let is_empty =
            self.returned.iter().all(Option::is_none) && self.events.iter().all(Option::is_none);
        Exchanged::Done(is_empty.then(|| contents.candidate.take()).flatten())
    }

    /// A tick of this number is done. The first one counts: weights that were adopted
    /// before it propose from it on.
    pub fn count_tick(&mut self, tick: u64) {
        self.first_tick.get_or_insert(tick);
    }

    /// Whether a tick is done.
    pub fn has_ticked(&self) -> bool {
        self.first_tick.is_some()
    }

    /// Holds everything that one more tick can return.
    pub fn has_space(&self) -> bool {
        let free = |count: usize| count + 4 <= RETURNS_MAX;
        free(self.returned.iter().flatten().count()) && free(self.events.iter().flatten().count())
    }

    /// Returns policies to be dropped.
    pub fn give_back(&mut self, policies: impl IntoIterator<Item = Option<Box<dyn Policy>>>) {
        for policy in policies.into_iter().flatten() {
            put(&mut self.returned, policy);
        }
    }

    /// Reports an event.
    pub fn report(&mut self, event: SwapEvent) {
        put(&mut self.events, event);
    }
}

fn put<T>(places: &mut [Option<T>], thing: T) {
    // There is always one: `has_space` is asked before anything happens. A policy
    // without one would be dropped here, which frees, but loses nothing else.
    if let Some(place) = places.iter_mut().find(|place| place.is_none()) {
        *place = Some(thing);
    }
}

/// Everything that fits, in order.
fn move_over<T>(from: &mut [Option<T>], to: &mut [Option<T>]) {
    let mut free = to.iter_mut().skip_while(|place| place.is_some());
    for thing in from {
        if thing.is_some() {
            match free.next() {
                Some(place) => *place = thing.take(),
                None => return,
            }
        }
    }
}
