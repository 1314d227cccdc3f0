//! The port at which actors of other machines join.
//!
//! Handshakes run on threads of their own, so that no peer delays the learner. TLS refuses a
//! peer without a certificate of the run's authority before it can send a frame.

use std::io;
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use anyhow::Context;
use rustls::pki_types::CertificateDer;
use rustls::{ServerConfig, ServerConnection, StreamOwned};
use shm_config::Instant;

use super::envelope::Rejection;
use super::order::SeatNumber;
use super::pool::{Close, SILENCE};
use super::tls::{ListenerKeys, is_of_actor, is_of_peer, listening};

/// Handshakes at a time: each is a thread for a moment. Further peers wait in the queue of the
/// operating system.
const HANDSHAKES_MAX: usize = 16;
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

/// The listening side.
pub struct Door {
    listener: TcpListener,
    config: Arc<ServerConfig>,
    keys: ListenerKeys,
    pending: Arc<AtomicUsize>,
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
            pending: Arc::default(),
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

    /// Begins handshakes with new peers, and returns those that are done: so many at most.
    ///
    /// # Errors
    /// When the system starts no thread.
    pub fn look(&mut self, room: usize) -> io::Result<Vec<Result<Arrived, Rejection>>> {
        while self.pending.load(Ordering::Acquire) < HANDSHAKES_MAX {
            let stream = match self.listener.accept() {
                Ok((stream, _)) => stream,
                // None waits; or it has gone already.
                Err(_) => break,
            };
            self.pending.fetch_add(1, Ordering::AcqRel);
            let (config, pending) = (Arc::clone(&self.config), Arc::clone(&self.pending));
            let (sender, keys) = (self.sender.clone(), self.keys.clone());
            thread::Builder::new()
                .name("actor-handshake".into())
                .spawn(move || {
                    let arrived = handshake(stream, config).and_then(|arrived| {
                        match is_revoked(&keys.revoked(), &arrived.certificate) {
                            true => Err(Rejection::Revoked),
                            false => Ok(arrived),
                        }
                    });
                    // The learner may have ended.
                    let _ = sender.send(arrived);
                    pending.fetch_sub(1, Ordering::AcqRel);
                })?;
        }
        Ok(self.arrivals.try_iter().take(room).collect())
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
    if !is_of_actor(&certificate) {
        return Err(Rejection::Role);
    }
    line.sock.set_read_timeout(Some(SILENCE)).map_err(broken)?;
    line.sock.set_write_timeout(Some(SILENCE)).map_err(broken)?;
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
