//! The processes from which messages are taken.
//!
//! The library writes into each message's envelope which process sent it; the header
//! inside is the sender's own claim. A process of a run takes state only from the
//! processes on the roster of the run's supervisor.

use std::cell::{Cell, RefCell};

use iceoryx2::prelude::*;
use iceoryx2::service::header::publish_subscribe::Header as Envelope;
use rustix::process::{Pid, test_kill_process};

use super::Ipc;
use crate::message::{RefusalKind, Refusals, Roster};
use crate::services::{Process, TakenFrom};

type Port = iceoryx2::port::subscriber::Subscriber<Ipc, Roster, ()>;

/// Rosters that are read in one call: one for each possible publisher.
const ROSTERS_MAX: usize = super::PUBLISHERS_MAX;

/// A process that sends in place of one that the run has started.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Foreigner {
    /// Its process id.
    pub pid: u32,
    /// The process in whose place it sends.
    pub place: Process,
}

/// The source of the roster.
enum Author {
    /// No roster: messages of every process are taken.
    Unset,
    /// The roster of this membership.
    Own,
    /// The roster of this process, read from this port.
    Other(u32, Port),
}

/// What a membership knows about the run's processes.
pub(super) struct Producers {
    author: RefCell<Author>,
    roster: RefCell<Roster>,
    foreigner: Cell<Option<Foreigner>>,
    contests: Cell<u64>,
    refused: Cell<Refusals>,
}

/// The process that sent a message, as the library reports it.
fn sender(envelope: &Envelope) -> u32 {
    let pid = envelope.node_id().pid::<Ipc>();
    // No process has the id 0, so it is on no roster.
    pid.map_or(0, |pid| pid.value().unsigned_abs())
}

/// Whether the process exists, of any user.
fn lives(pid: u32) -> bool {
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
    pid.is_some_and(|pid| test_kill_process(pid) != Err(rustix::io::Errno::SRCH))
}

impl Producers {
    /// Takes messages of every process.
    pub(super) fn open() -> Self {
        Self {
            author: RefCell::new(Author::Unset),
            roster: RefCell::new(Roster::default()),
            foreigner: Cell::new(None),
            contests: Cell::new(0),
            refused: Cell::new(Refusals::default()),
        }
    }

    /// From now on takes messages only of processes on this roster.
    pub(super) fn set(&self, roster: &Roster) {
        *self.author.borrow_mut() = Author::Own;
        *self.roster.borrow_mut() = *roster;
    }

    /// From now on takes messages only of processes on the rosters of this process.
    pub(super) fn follow(&self, author: u32, port: Port) {
        *self.author.borrow_mut() = Author::Other(author, port);
        *self.roster.borrow_mut() = Roster::default();
        self.look();
    }

    /// Whether the roster is that of another process.
    pub(super) fn follows(&self) -> bool {
        matches!(*self.author.borrow(), Author::Other(..))
    }

    /// The process that the roster names, `None` when it names none.
    pub(super) fn pid(&self, process: Process) -> Option<u32> {
        self.look();
        self.roster.borrow().pid(process)
    }

    /// Reads the newest roster. Never allocates or waits.
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

    /// Whether a message in this envelope is taken, for a service of this producer. A
    /// refused message is counted, and its sender noted.
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
        // The sender may have been started since the last read of the roster.
        self.look();
        if is_known() {
            return true;
        }
        // Unread messages of a dead predecessor are refused like others; two living
        // processes that send in one place are a contest.
        if lives(pid) {
            self.contests.set(self.contests.get() + 1);
            self.foreigner.set(Some(Foreigner { pid, place }));
        }
        false
    }

    /// Two memberships with one process id are a contest too: a process of another pid
    /// namespace may have the id of one of the run. A process publishes a service from
    /// one membership for its whole life, so a change without a new roster shows two of
    /// them.
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

    /// Messages refused because the run did not start their living sender for the
    /// service.
    pub(super) fn contests(&self) -> u64 {
        self.contests.get()
    }

    /// The last process that sent such a message.
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
