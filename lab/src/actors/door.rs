//! The port at which actors of other machines join.
//!
//! Handshakes run on threads of their own, so that no peer delays the learner. TLS refuses a
//! peer without a certificate of the run's authority before it can send a frame.

use std::collections::BTreeMap;
use std::io;
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use anyhow::Context;
use rustls::pki_types::CertificateDer;
use rustls::{ServerConfig, ServerConnection, StreamOwned};
use shm_config::Instant;

use super::connection::turn_away;
use super::envelope::{Kind, Rejection, receive};
use super::order::SeatNumber;
use super::pool::{Close, SILENCE};
use super::tls::{ListenerKeys, is_of_actor, is_of_peer, listening};

/// Handshakes at a time: each is a thread for a moment. A further peer ends the oldest: an actor
/// completes its own within milliseconds, and peers that say nothing keep none out.
const HANDSHAKES_MAX: usize = 64;
/// Peers that are accepted in one look: each has the time until the next one for its handshake,
/// however many wait.
const ACCEPTED_MAX: usize = HANDSHAKES_MAX / 2;
/// A peer that sends nothing for this time in its handshake is refused.
const HANDSHAKE: Duration = Duration::from_secs(10);
/// Interval at which the run's keys are read for revoked invitations, ns.
const REVOKED_NS: u64 = 2_000_000_000;

/// A connection that TLS has admitted.
pub struct Arrived {
    /// The connection.
    pub line: StreamOwned<ServerConnection, TcpStream>,
    /// The actor's certificate.
    pub certificate: CertificateDer<'static>,
    /// Ends it from outside.
    pub close: Close,
}

/// The connections whose handshakes are not done, by their number.
type Pending = Arc<Mutex<BTreeMap<u64, TcpStream>>>;

/// A thread that holds the lock does not panic.
fn held(pending: &Pending) -> MutexGuard<'_, BTreeMap<u64, TcpStream>> {
    pending.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The listening side.
pub struct Door {
    listener: TcpListener,
    config: Arc<ServerConfig>,
    keys: ListenerKeys,
    pending: Pending,
    accepted: u64,
    sender: SyncSender<Result<Arrived, Rejection>>,
    arrivals: Receiver<Result<Arrived, Rejection>>,
    looked: Option<Instant>,
}

impl Door {
    /// Listens at `HOST:PORT` of this machine.
    ///
    /// # Errors
    /// When the address is not this machine's or in use, or a key is damaged.
    pub fn open(address: &str, keys: ListenerKeys) -> anyhow::Result<Door> {
        let config = listening(&keys)?;
        let named = || format!("--actors-at {address}");
        let listener = TcpListener::bind(address).with_context(named)?;
        listener.set_nonblocking(true).with_context(named)?;
        let (sender, arrivals) = sync_channel(HANDSHAKES_MAX);
        Ok(Door {
            listener,
            config,
            keys,
            pending: Pending::default(),
            accepted: 0,
            sender,
            arrivals,
            looked: None,
        })
    }

    /// The address at which it listens.
    ///
    /// # Errors
    /// When the system does not say it.
    pub fn address(&self) -> io::Result<std::net::SocketAddr> {
        self.listener.local_addr()
    }

    /// Begins handshakes with new peers, and returns those that are done: so many admitted ones
    /// at most, and all that are refused.
    ///
    /// # Errors
    /// When the system starts no thread.
    pub fn look(&mut self, room: usize) -> io::Result<Vec<Result<Arrived, Rejection>>> {
        let mut arrivals = Vec::new();
        if room == 0 {
            return Ok(arrivals);
        }
        for _ in 0..ACCEPTED_MAX {
            match self.listener.accept() {
                Ok((stream, _)) => self.begin(stream)?,
                // None waits; or it has gone already.
                Err(_) => break,
            }
        }
        let mut admitted = 0;
        while admitted < room
            && let Ok(arrival) = self.arrivals.try_recv()
        {
            admitted += usize::from(arrival.is_ok());
            arrivals.push(arrival);
        }
        Ok(arrivals)
    }

    /// Begins a handshake.
    fn begin(&mut self, stream: TcpStream) -> io::Result<()> {
        let Ok(own) = stream.try_clone() else {
            // No descriptor is left; it may try again.
            return Ok(());
        };
        self.accepted += 1;
        let number = self.accepted;
        let mut waiting = held(&self.pending);
        if waiting.len() == HANDSHAKES_MAX
            && let Some((_, oldest)) = waiting.pop_first()
        {
            // Its thread reads the end.
            let _ = oldest.shutdown(Shutdown::Both);
        }
        waiting.insert(number, own);
        drop(waiting);
        let (config, pending) = (Arc::clone(&self.config), Arc::clone(&self.pending));
        let (sender, keys) = (self.sender.clone(), self.keys.clone());
        let thread = thread::Builder::new().name("actor-handshake".into());
        thread.spawn(move || {
            let arrived = admitted(stream, config, &keys);
            held(&pending).remove(&number);
            // The learner may have ended.
            let _ = sender.send(arrived);
        })?;
        Ok(())
    }

    /// The connections whose invitation is revoked; all, if the run's keys are gone.
    pub fn revoked<'a>(
        &mut self,
        now: Instant,
        certified: impl Iterator<Item = (SeatNumber, &'a CertificateDer<'static>)>,
    ) -> Vec<SeatNumber> {
        let is_fresh = |looked: Instant| now.since_ns(looked) < REVOKED_NS;
        if self.looked.is_some_and(is_fresh) {
            return Vec::new();
        }
        self.looked = Some(now);
        let revoked = self.keys.revoked();
        certified
            .filter(|(_, certificate)| is_revoked(&revoked, certificate))
            .map(|(seat, _)| seat)
            .collect()
    }
}

/// Whether an invitation is revoked: each is if the keys are gone.
fn is_revoked(revoked: &Option<Vec<String>>, certificate: &CertificateDer<'_>) -> bool {
    match revoked {
        None => true,
        Some(revoked) => revoked.iter().any(|peer| is_of_peer(certificate, peer)),
    }
}

/// The connection of an actor whose invitation holds. Another one is told why it does not.
fn admitted(
    stream: TcpStream,
    config: Arc<ServerConfig>,
    keys: &ListenerKeys,
) -> Result<Arrived, Rejection> {
    let mut arrived = handshake(stream, config)?;
    let why = match &arrived.certificate {
        other if !is_of_actor(other) => Rejection::Role,
        known if is_revoked(&keys.revoked(), known) => Rejection::Revoked,
        _ => {
            let line = &arrived.line.sock;
            let set = line.set_read_timeout(Some(SILENCE));
            let set = set.and_then(|()| line.set_write_timeout(Some(SILENCE)));
            return set.map(|()| arrived).map_err(|_| Rejection::Certificate);
        }
    };
    // What it has sent is read first: otherwise the answer may be lost with it.
    if receive(&mut arrived.line, &[Kind::Hello], &mut Vec::new()).is_ok() {
        // It may be gone.
        let _ = turn_away(&mut arrived.line, why);
    }
    Err(why)
}

fn handshake(stream: TcpStream, config: Arc<ServerConfig>) -> Result<Arrived, Rejection> {
    let broken = |_: io::Error| Rejection::Certificate;
    stream.set_nonblocking(false).map_err(broken)?;
    stream.set_read_timeout(Some(HANDSHAKE)).map_err(broken)?;
    stream.set_write_timeout(Some(HANDSHAKE)).map_err(broken)?;
    // Frames are whole, and the other side waits for each.
    stream.set_nodelay(true).map_err(broken)?;
    let own = stream.try_clone().map_err(broken)?;
    let connection = ServerConnection::new(config).map_err(|_| Rejection::Certificate)?;
    let mut line = StreamOwned::new(connection, stream);
    while line.conn.is_handshaking() {
        line.conn.complete_io(&mut line.sock).map_err(broken)?;
    }
    let chain = line.conn.peer_certificates().unwrap_or_default();
    let certificate = chain
        .first()
        .ok_or(Rejection::Certificate)?
        .clone()
        .into_owned();
    let close = Box::new(move || {
        // It may have ended.
        let _ = own.shutdown(Shutdown::Both);
    });
    Ok(Arrived {
        line,
        certificate,
        close,
    })
}
