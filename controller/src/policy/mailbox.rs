//! How policies change hands between the loader's thread and the tick's.
//!
//! One desk behind a lock that is held for moving a few pointers. The tick's
//! side only ever tries the lock, between two ticks, and comes back later when
//! it is taken: it never waits, and never allocates or frees.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use super::{Begin, Fault, Policy};

/// Things that may lie on the way to the loader at a time. One turn gives back
/// at most two policies and says one thing; the tick's side takes nothing new
/// up before they are gone.
const WAY_MAX: usize = 8;

/// A checked, built and warmed policy.
pub struct Offer {
    /// What.
    pub policy: Box<dyn Policy>,
    /// How it begins.
    pub begin: Begin,
}

/// What the tick's side says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum News {
    /// This version was taken up.
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
    /// It was given up.
    RolledBack {
        /// The version.
        version: u64,
        /// From this tick on.
        tick: u64,
        /// Why.
        fault: Fault,
        /// Version and hash in charge now; zeros for none.
        charged: (u64, u64),
    },
}

/// What lies between the two.
#[derive(Default)]
pub struct Desk {
    /// For the tick.
    pub offer: Option<Offer>,
    /// For the loader, to be dropped.
    pub returned: [Option<Box<dyn Policy>>; WAY_MAX],
    /// For the loader, in order.
    pub news: [Option<News>; WAY_MAX],
    /// The number of the first tick of this controller; `None` before it.
    pub first_tick: Option<u64>,
}

/// The desk, and up to which version the loader has decided.
#[derive(Default)]
pub struct Exchange {
    /// The desk.
    pub desk: Mutex<Desk>,
    decided: AtomicU64,
}

impl Exchange {
    /// Up to this version, every offer is refused or lies on the desk.
    pub fn decided(&self) -> u64 {
        self.decided.load(Ordering::Acquire)
    }

    /// The loader has decided.
    pub fn decide(&self, version: u64) {
        self.decided.fetch_max(version, Ordering::Release);
    }
}

/// The tick's side of the desk.
#[derive(Default)]
pub struct Hand {
    returned: [Option<Box<dyn Policy>>; WAY_MAX],
    news: [Option<News>; WAY_MAX],
    first_tick: Option<u64>,
}

/// What a look at the desk brought.
pub enum Look {
    /// The desk is taken: look again later.
    Taken,
    /// What lay there for the tick.
    Seen(Option<Offer>),
}

impl Hand {
    /// Puts down what has gathered and takes what is there. Never waits.
    pub fn look(&mut self, exchange: &Exchange) -> Look {
        let Ok(mut desk) = exchange.desk.try_lock() else {
            return Look::Taken;
        };
        move_over(&mut self.returned, &mut desk.returned);
        move_over(&mut self.news, &mut desk.news);
        desk.first_tick = self.first_tick;
        let is_empty =
            self.returned.iter().all(Option::is_none) && self.news.iter().all(Option::is_none);
        Look::Seen(is_empty.then(|| desk.offer.take()).flatten())
    }

    /// A tick of this number is done. The first one counts: what was taken up before it
    /// proposes from it on.
    pub fn count_tick(&mut self, tick: u64) {
        self.first_tick.get_or_insert(tick);
    }

    /// Whether a tick is done.
    pub fn has_ticked(&self) -> bool {
        self.first_tick.is_some()
    }

    /// Has room for everything that one tick can bring.
    pub fn has_room(&self) -> bool {
        let free = |count: usize| count + 4 <= WAY_MAX;
        free(self.returned.iter().flatten().count()) && free(self.news.iter().flatten().count())
    }

    /// Policies to be dropped.
    pub fn give_back(&mut self, policies: impl IntoIterator<Item = Option<Box<dyn Policy>>>) {
        for policy in policies.into_iter().flatten() {
            put(&mut self.returned, policy);
        }
    }

    /// Something to be said.
    pub fn say(&mut self, news: News) {
        put(&mut self.news, news);
    }
}

fn put<T>(places: &mut [Option<T>], thing: T) {
    // There is always one: `has_room` is asked before anything happens. A policy
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
