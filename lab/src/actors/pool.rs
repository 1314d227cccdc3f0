//! All connections of a learner.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rustls::pki_types::CertificateDer;

use super::connection::{Asked, Guest, Seat, SeatEvent};
use super::message::EpisodeKey;
use super::order::SeatNumber;

/// Most connections at a time. Each may hold an episode that is being received; with all beams
/// and MetaDrive's horizon that is 11 MB.
pub const SEATS_MAX: usize = 64;
/// Whole episodes between the connections and the learner; each connection has one more.
const EVENTS_MAX: usize = 4;
/// An actor that sends nothing for this time has hung, or its machine is gone.
pub const SILENCE: Duration = Duration::from_secs(120);

/// Ends a connection from outside.
pub type Close = Box<dyn Fn() + Send>;

/// Name of a connection whose actor has not said its own.
pub const UNKNOWN: &str = "a peer";

/// One actor, as the learner sees it.
struct Actor {
    name: String,
    /// Takes the next episode; none before the actor is ready.
    orders: SyncSender<Asked>,
    is_ready: bool,
    driving: Option<EpisodeKey>,
    /// Of an actor on another machine.
    certificate: Option<CertificateDer<'static>>,
    close: Close,
    thread: JoinHandle<()>,
}

/// The connections.
pub struct Pool {
    configuration: Arc<str>,
    sender: SyncSender<SeatEvent>,
    events: Receiver<SeatEvent>,
    actors: BTreeMap<SeatNumber, Actor>,
    next: SeatNumber,
}

impl Pool {
    /// Without connections; this configuration is sent to each.
    pub fn new(configuration: String) -> Pool {
        let (sender, events) = sync_channel(EVENTS_MAX);
        Pool {
            configuration: configuration.into(),
            sender,
            events,
            actors: BTreeMap::new(),
            next: 0,
        }
    }

    /// How many more connections it takes.
    pub fn room(&self) -> usize {
        SEATS_MAX.saturating_sub(self.actors.len())
    }

    /// Serves a connection on a thread of its own; `close` ends it from outside.
    ///
    /// # Errors
    /// When the system starts no thread.
    pub fn add(
        &mut self,
        guest: Guest,
        mut line: impl Read + Write + Send + 'static,
        close: Close,
    ) -> io::Result<SeatNumber> {
        let number = self.next;
        self.next += 1;
        // An actor has one episode at a time, so that sending an order never waits.
        let (orders, received) = sync_channel(1);
        let (name, certificate) = match &guest {
            Guest::Own(name) => (name.clone(), None),
            Guest::Certified(certificate) => (UNKNOWN.into(), Some(certificate.clone())),
        };
        let seat = Seat {
            number,
            guest,
            events: self.sender.clone(),
            orders: received,
        };
        let configuration = Arc::clone(&self.configuration);
        let thread = thread::Builder::new()
            .name(format!("actor-{number}"))
            .spawn(move || seat.serve(&mut line, &configuration))?;
        let actor = Actor {
            name,
            orders,
            is_ready: false,
            driving: None,
            certificate,
            close,
            thread,
        };
        self.actors.insert(number, actor);
        Ok(number)
    }

    /// Adds a connection within this machine.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn add_local(&mut self, name: String, line: UnixStream) -> io::Result<SeatNumber> {
        line.set_read_timeout(Some(SILENCE))?;
        line.set_write_timeout(Some(SILENCE))?;
        let own = line.try_clone()?;
        let close = Box::new(move || {
            // It may have ended.
            let _ = own.shutdown(std::net::Shutdown::Both);
        });
        self.add(Guest::Own(name), line, close)
    }

    /// The next event; `None` after this time.
    pub fn event(&mut self, patience: Duration) -> Option<SeatEvent> {
        let event = match self.events.recv_timeout(patience) {
            Ok(event) => event,
            // The pool has a sender itself.
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => return None,
        };
        match &event {
            SeatEvent::Ready(number, name) => {
                if let Some(actor) = self.actors.get_mut(number) {
                    (actor.is_ready, actor.name) = (true, name.clone());
                }
            }
            SeatEvent::Whole(number, key, _) => {
                if let Some(actor) = self.actors.get_mut(number)
                    && actor.driving == Some(*key)
                {
                    actor.driving = None;
                }
            }
            SeatEvent::Gone(..) => {}
        }
        Some(event)
    }

    /// Actors that wait for an episode.
    pub fn idle(&self) -> Vec<SeatNumber> {
        let idle = |actor: &Actor| actor.is_ready && actor.driving.is_none();
        let actors = self.actors.iter().filter(|(_, actor)| idle(actor));
        actors.map(|(number, _)| *number).collect()
    }

    /// Asks an idle actor for an episode.
    pub fn ask(&mut self, number: SeatNumber, asked: Asked) {
        if let Some(actor) = self.actors.get_mut(&number) {
            actor.driving = Some(asked.assignment.key);
            // Its end is the next event of a connection that has ended meanwhile.
            let _ = actor.orders.send(asked);
        }
    }

    /// The actor's name; `None` once it is removed.
    pub fn name(&self, number: SeatNumber) -> Option<&str> {
        self.actors.get(&number).map(|actor| &*actor.name)
    }

    /// The connections of actors on other machines, with their certificates.
    pub fn certified(&self) -> impl Iterator<Item = (SeatNumber, &CertificateDer<'static>)> {
        let actors = self.actors.iter();
        actors.filter_map(|(number, actor)| Some((*number, actor.certificate.as_ref()?)))
    }

    /// Removes a connection that has ended, or ends it.
    pub fn remove(&mut self, number: SeatNumber) {
        if let Some(actor) = self.actors.remove(&number) {
            (actor.close)();
        }
    }

    /// Ends all: idle actors are told that nothing is left; the others may end their episode
    /// within this time.
    pub fn finish(self, patience: Duration, pause: impl Fn(Duration)) {
        // No one takes the events any more.
        drop(self.events);
        let mut left: Vec<_> = self.actors.into_values().collect();
        let look = Duration::from_millis(20);
        let mut waited = Duration::ZERO;
        left = left
            .into_iter()
            .map(|actor| Actor {
                // The thread sees that no order comes any more.
                orders: sync_channel(0).0,
                ..actor
            })
            .collect();
        while waited < patience && left.iter().any(|actor| !actor.thread.is_finished()) {
            pause(look);
            waited += look;
        }
        for actor in left {
            (actor.close)();
        }
    }
}
