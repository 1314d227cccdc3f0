//! From which processes messages are taken.
//!
//! The library writes into each message's envelope which process sent it; the header
//! inside is the sender's own claim. A process of a run takes state only from the
//! processes that the run's supervisor names in its roster.

use std::cell::{Cell, RefCell};

use iceoryx2::prelude::*;
use iceoryx2::service::header::publish_subscribe::Header as Envelope;
use rustix::process::{Pid, test_kill_process};

use super::Ipc;
use crate::message::{RefusalKind, Refusals, Roster};
use crate::services::{Process, TakenFrom};

type Port = iceoryx2::port::subscriber::Subscriber<Ipc, Roster, ()>;

/// Rosters looked at in one go: one of each publisher there can be.
const ROSTERS_MAX: usize = super::PUBLISHERS_MAX;

/// A process that sends in the place of one that the run has started.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Foreigner {
    /// Its process id.
    pub pid: u32,
    /// In whose place it sends.
    pub place: Process,
}

/// Whose roster counts.
enum Author {
    /// Every process is taken for what it claims: no roster is followed.
    Unset,
    /// The own one.
    Own,
    /// That of this process, read from this port.
    Other(u32, Port),
}

/// What a membership knows of the run's processes.
pub(super) struct Producers {
    author: RefCell<Author>,
    roster: RefCell<Roster>,
    foreigner: Cell<Option<Foreigner>>,
    contests: Cell<u64>,
    refused: Cell<Refusals>,
}

/// The process that sent a message, as the library says.
fn sender(envelope: &Envelope) -> u32 {
    let pid = envelope.node_id().pid::<Ipc>();
    // No process has the id 0: it is on no roster.
    pid.map_or(0, |pid| pid.value().unsigned_abs())
}

/// The process exists, of any user.
fn lives(pid: u32) -> bool {
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
    pid.is_some_and(|pid| test_kill_process(pid) != Err(rustix::io::Errno::SRCH))
}

impl Producers {
    /// Takes from every process.
    pub(super) fn open() -> Self {
        Self {
            author: RefCell::new(Author::Unset),
            roster: RefCell::new(Roster::default()),
            foreigner: Cell::new(None),
            contests: Cell::new(0),
            refused: Cell::new(Refusals::default()),
        }
    }

    /// From now on takes from those that this roster names alone.
    pub(super) fn set(&self, roster: &Roster) {
        *self.author.borrow_mut() = Author::Own;
        *self.roster.borrow_mut() = *roster;
    }

    /// From now on takes from those alone that the rosters of this process name.
    pub(super) fn follow(&self, author: u32, port: Port) {
        *self.author.borrow_mut() = Author::Other(author, port);
        *self.roster.borrow_mut() = Roster::default();
        self.look();
    }

    /// The process that the roster names, `None` when it names none.
    pub(super) fn pid(&self, process: Process) -> Option<u32> {
        self.look();
        self.roster.borrow().pid(process)
    }

    /// Takes in the newest roster. Never allocates or waits.
    fn look(&self) {
        let author = self.author.borrow();
        let Author::Other(author, port) = &*author else {
            return;
        };
        for _ in 0..ROSTERS_MAX {
            let Ok(Some(sample)) = port.receive() else {
                return;
            };
            let pid = sender(sample.header());
            if pid == *author {
                *self.roster.borrow_mut() = *sample.payload();
            } else {
                self.count(RefusalKind::Foreign);
                let place = Process::Supervisor;
                self.foreigner.set(Some(Foreigner { pid, place }));
            }
        }
    }

    /// Whether a message in this envelope, of a service of that producer, is taken.
    /// One that is not is counted, and its sender noted.
    pub(super) fn admits(
        &self,
        envelope: &Envelope,
        (place, taken_from): (Process, TakenFrom),
    ) -> bool {
        if taken_from == TakenFrom::Anyone || matches!(*self.author.borrow(), Author::Unset) {
            return true;
        }
        let pid = sender(envelope);
        let is_known = || self.roster.borrow().pid(place) == Some(pid);
        if is_known() {
            return true;
        }
        // It may have been started since the last look.
        self.look();
        if is_known() {
            return true;
        }
        // What a dead predecessor left unread is refused like all else, but two that
        // live and send in one place are a contest.
        if lives(pid) {
            self.contests.set(self.contests.get() + 1);
            self.foreigner.set(Some(Foreigner { pid, place }));
        }
        false
    }

    /// Two memberships with one process id are a contest as well: a process of another
    /// pid namespace may have the id of one of the run. A process publishes a service
    /// from one membership for as long as it lives, so a change without a new roster is
    /// two of them.
    pub(super) fn compare(
        &self,
        envelope: &Envelope,
        (place, taken_from): (Process, TakenFrom),
        last: &mut Option<(u32, u128)>,
    ) {
        if taken_from == TakenFrom::Anyone || matches!(*self.author.borrow(), Author::Unset) {
            return;
        }
        let (pid, membership) = (sender(envelope), envelope.node_id().value());
        let before = last.replace((pid, membership));
        if before.is_some_and(|(other, node)| other == pid && node != membership) {
            self.contests.set(self.contests.get() + 1);
            self.foreigner.set(Some(Foreigner { pid, place }));
        }
    }

    /// Messages of living processes that were refused because the run did not start
    /// them for it.
    pub(super) fn contests(&self) -> u64 {
        self.contests.get()
    }

    /// The last process that sent one.
    pub(super) fn foreigner(&self) -> Option<Foreigner> {
        self.foreigner.get()
    }

    /// Counts messages that a port refused.
    pub(super) fn count(&self, kind: RefusalKind) {
        let mut refused = self.refused.get();
        refused.count(kind);
        self.refused.set(refused);
    }

    /// Messages that all ports of the membership refused, by reason.
    pub(super) fn refused(&self) -> Refusals {
        self.refused.get()
    }
}
