//! Packets over Zenoh: TLS alone, with certificates on both sides, no search for others.
//!
//! | key expression | from | to |
//! |---|---|---|
//! | `vlaps/RUN/ROLE/up/PEER` | a peer | the vehicle |
//! | `vlaps/RUN/ROLE/down/PEER` | the vehicle | that peer |
//!
//! RUN and PEER are identities, random numbers of 32 digits. Zenoh carries packets and
//! decides nothing: what it delivers passes a door.

use std::io;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use shm_config::Instant;
use shm_config::time::monotonic;
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;
use zenoh::{Config, Session, Wait};

use crate::certificate::Certified;
use crate::keys::{Bundle, Identity, RunKeys};
use crate::packet::PACKET_MAX;
use crate::role::Role;

/// Packets that wait to be read: at 1,000 Hz a second. More is refused as a flood.
const INBOUND_MAX: usize = 1024;
/// Bytes of the packets that wait in one direction, at most.
const WAITING_BYTES_MAX: usize = 64 << 20;
/// Packets that wait to be sent.
const OUTBOUND_MAX: usize = 1024;
/// How long one attempt to connect may take, ms; the next one follows at once. On a busy
/// port, or beside connections that say nothing, a handshake takes more than a second.
const ATTEMPT_MS: u64 = 3_000;
/// How long a connection to the vehicle may take for its TLS handshake, ms: two of them that
/// say nothing pass within one attempt.
const HANDSHAKE_MS: u64 = 1_400;
const _: () = assert!(2 * HANDSHAKE_MS < ATTEMPT_MS);
/// Pause between two attempts.
const PAUSE: Duration = Duration::from_millis(100);
/// How long Zenoh may wait for a connection that says nothing, ms.
const LEASE_MS: u64 = 1_000;
/// How long Zenoh may hold a packet for a full connection before it drops it, us. The packet
/// is then sent again.
const HELD_US: i64 = 20_000;
/// Bytes that Zenoh takes in one message: a batch, which it does not cut into fragments.
const MESSAGE_BYTES_MAX: usize = 64 << 10;
const _: () = {
    // With what Zenoh and a key expression of 100 bytes add.
    assert!(PACKET_MAX + 1024 < MESSAGE_BYTES_MAX);
    assert!(INBOUND_MAX * MESSAGE_BYTES_MAX <= WAITING_BYTES_MAX);
    assert!(OUTBOUND_MAX * PACKET_MAX <= WAITING_BYTES_MAX);
};
/// Longest wait for a packet to be sent, so that the end of the program is seen.
const TURN: Duration = Duration::from_millis(50);

/// Zenoh's variable for its threads, which it reads once, and the value that makes one thread
/// of the two that read and write a connection. Both use its TLS state without a lock, and a
/// process with traffic in both directions crashes (eclipse-zenoh/zenoh#2557).
const THREADS: (&str, &str) = ("ZENOH_RUNTIME", "(rx: (handover: tx))");

/// Starts this program again with [`THREADS`] in its environment, in the same process; nothing
/// when it is there. Call it before anything else: what the process has opened is lost.
///
/// # Errors
/// One line: the program cannot be started.
pub fn use_one_thread() -> Result<(), String> {
    let (name, value) = THREADS;
    if std::env::var_os(name).is_some_and(|set| set == value) {
        return Ok(());
    }
    let start = |program: &Path| {
        let mut words = std::env::args_os();
        let mut command = Command::new(program);
        if let Some(first) = words.next() {
            command.arg0(first);
        }
        command.args(words).env(name, value).exec()
    };
    let error = match std::env::current_exe() {
        Ok(program) => start(&program),
        Err(error) => error,
    };
    let error = match error.kind() {
        // An update has replaced the file; the running program is still here.
        io::ErrorKind::NotFound => start(Path::new("/proc/self/exe")),
        _ => error,
    };
    Err(format!(
        "cannot start this program again with {name}={value}: {error}"
    ))
}

/// A packet with the instant at which it came.
pub struct Arrived {
    /// When.
    pub at: Instant,
    /// The packet.
    pub bytes: Vec<u8>,
}

/// Where packets of peers come from and go to, on the vehicle.
pub struct Listener {
    inbound: Receiver<Arrived>,
    flooded: Arc<AtomicU64>,
    session: Session,
    prefix: String,
    _subscriber: Subscriber<()>,
}

fn first(error: &zenoh::Error) -> String {
    let text = error.to_string();
    let line = text.lines().next().unwrap_or_default();
    line.split(" at /").next().unwrap_or_default().to_string()
}

/// What all sessions have in common.
fn common(mode: &str) -> Vec<(&'static str, Value)> {
    vec![
        ("mode", json!(mode)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("transport/shared_memory/enabled", json!(false)),
        ("transport/link/protocols", json!(["tls"])),
        ("transport/link/tx/lease", json!(LEASE_MS)),
        (
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop",
            json!(HELD_US),
        ),
        (
            "transport/link/rx/max_message_size",
            json!(MESSAGE_BYTES_MAX),
        ),
        ("transport/unicast/open_timeout", json!(ATTEMPT_MS)),
        ("transport/unicast/accept_timeout", json!(2 * ATTEMPT_MS)),
        ("transport/link/tls/enable_mtls", json!(true)),
        ("transport/link/tls/close_link_on_expiration", json!(true)),
    ]
}

fn config(settings: Vec<(&'static str, Value)>) -> Result<Config, String> {
    let mut config = Config::default();
    for (key, value) in settings {
        let set = config.insert_json5(key, &value.to_string());
        set.map_err(|error| format!("{key}: {}", first(&error)))?;
    }
    Ok(config)
}

fn encoded(text: &str) -> Value {
    json!(STANDARD.encode(text))
}

fn prefix(run: Identity) -> String {
    format!("vlaps/{run}")
}

/// Gives packets on without waiting; those that do not fit are counted.
fn receiver(
    sender: SyncSender<Arrived>,
    flooded: Arc<AtomicU64>,
) -> impl Fn(zenoh::sample::Sample) + Send + Sync + 'static {
    move |sample| {
        let bytes = sample.payload().to_bytes().into_owned();
        let arrived = Arrived {
            at: monotonic_now(),
            bytes,
        };
        if let Err(TrySendError::Full(_)) = sender.try_send(arrived) {
            flooded.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[allow(clippy::disallowed_methods)] // the instant at which a packet comes is read here
fn monotonic_now() -> Instant {
    monotonic()
}

impl Listener {
    /// Listens for peers of these roles at `HOST:PORT`.
    ///
    /// # Errors
    /// One line: the address is none of this machine, or is taken.
    pub fn open(keys: &RunKeys, address: &str) -> Result<Self, String> {
        let Certified { certificate, key } = keys
            .authority
            .vehicle()
            .map_err(|error| error.to_string())?;
        let mut settings = common("peer");
        settings.extend([
            (
                "listen/endpoints",
                json!([format!(
                    "tls/{address}#tls_handshake_timeout_ms={HANDSHAKE_MS}"
                )]),
            ),
            ("listen/exit_on_failure", json!(true)),
            ("connect/endpoints", json!([])),
            (
                "transport/link/tls/root_ca_certificate_base64",
                encoded(&keys.authority.certificate),
            ),
            (
                "transport/link/tls/listen_certificate_base64",
                encoded(&certificate),
            ),
            (
                "transport/link/tls/listen_private_key_base64",
                encoded(&key),
            ),
        ]);
        let opened = zenoh::open(config(settings)?).wait();
        let session =
            opened.map_err(|error| format!("cannot listen at {address}: {}", first(&error)))?;
        let prefix = prefix(keys.identity);
        let (sender, inbound) = sync_channel(INBOUND_MAX);
        let flooded = Arc::new(AtomicU64::new(0));
        let subscriber = session
            .declare_subscriber(format!("{prefix}/*/up/*"))
            .callback(receiver(sender, flooded.clone()))
            .wait()
            .map_err(|error| first(&error))?;
        Ok(Self {
            inbound,
            flooded,
            session,
            prefix,
            _subscriber: subscriber,
        })
    }

    /// The next packet that has come.
    pub fn receive(&self) -> Option<Arrived> {
        self.inbound.try_recv().ok()
    }

    /// Packets that came while too many waited, since the last call.
    pub fn take_flooded(&self) -> u64 {
        self.flooded.swap(0, Ordering::Relaxed)
    }

    /// Sends a packet to a peer, or drops it when the connection is full.
    pub fn send(&self, (role, peer): (Role, Identity), bytes: Vec<u8>) {
        let key = format!("{}/{role}/down/{peer}", self.prefix);
        let put = self.session.put(key, bytes);
        // A packet that is not taken is sent again.
        let _ = put.congestion_control(CongestionControl::Drop).wait();
    }
}

/// A connection to the vehicle, made again whenever it is lost, by a thread of its own.
pub struct Connection {
    inbound: Receiver<Arrived>,
    outbound: SyncSender<Vec<u8>>,
    flooded: Arc<AtomicU64>,
    shared: Arc<Shared>,
    thread: Option<std::thread::JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    /// The connection is to be made again.
    renew: AtomicBool,
    end: AtomicBool,
    is_open: AtomicBool,
}

impl Connection {
    /// Connects to the vehicle of an invitation.
    ///
    /// # Errors
    /// When the invitation is damaged.
    pub fn open(bundle: &Bundle, address: &str) -> Result<Self, String> {
        let mut settings = common("client");
        settings.extend([
            ("listen/endpoints", json!([])),
            (
                "connect",
                json!({
                    "endpoints": [format!("tls/{address}")],
                    "timeout_ms": ATTEMPT_MS,
                    "exit_on_failure": true,
                }),
            ),
            (
                "transport/link/tls/root_ca_certificate_base64",
                encoded(&bundle.authority),
            ),
            (
                "transport/link/tls/connect_certificate_base64",
                encoded(&bundle.certificate.certificate),
            ),
            (
                "transport/link/tls/connect_private_key_base64",
                encoded(&bundle.certificate.key),
            ),
            // The run's own authority makes one certificate of a vehicle, which is valid
            // at each of its addresses.
            ("transport/link/tls/verify_name_on_connect", json!(false)),
        ]);
        let config = config(settings)?;
        let role = bundle.role().map_err(|error| error.to_string())?;
        let prefix = format!("{}/{role}", prefix(bundle.identity));
        let keys = [
            format!("{prefix}/up/{}", bundle.peer),
            format!("{prefix}/down/{}", bundle.peer),
        ];
        let (sender, inbound) = sync_channel(INBOUND_MAX);
        let (outbound, packets) = sync_channel(OUTBOUND_MAX);
        let flooded = Arc::new(AtomicU64::new(0));
        let shared = Arc::new(Shared::default());
        let work = Work {
            config,
            keys,
            sender,
            packets,
            flooded: flooded.clone(),
            shared: shared.clone(),
        };
        let thread = std::thread::Builder::new()
            .name("connection".into())
            .spawn(move || work.run())
            .map_err(|error| format!("cannot start a thread: {error}"))?;
        Ok(Self {
            inbound,
            outbound,
            flooded,
            shared,
            thread: Some(thread),
        })
    }

    /// The next packet, waited for at most this long.
    pub fn receive(&self, wait: Duration) -> Option<Arrived> {
        self.inbound.recv_timeout(wait).ok()
    }

    /// Packets that came while too many waited, since the last call.
    pub fn take_flooded(&self) -> u64 {
        self.flooded.swap(0, Ordering::Relaxed)
    }

    /// Sends a packet, or drops it while there is no connection.
    pub fn send(&self, bytes: Vec<u8>) {
        let _ = self.outbound.try_send(bytes);
    }

    /// The vehicle is silent: connects anew.
    pub fn renew(&self) {
        self.shared.renew.store(true, Ordering::Relaxed);
    }

    /// Whether there is a connection.
    pub fn is_open(&self) -> bool {
        self.shared.is_open.load(Ordering::Relaxed)
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.shared.end.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Work {
    config: Config,
    keys: [String; 2],
    sender: SyncSender<Arrived>,
    packets: Receiver<Vec<u8>>,
    flooded: Arc<AtomicU64>,
    shared: Arc<Shared>,
}

impl Work {
    fn run(&self) {
        let is_ended = || self.shared.end.load(Ordering::Relaxed);
        while !is_ended() {
            let Ok(session) = zenoh::open(self.config.clone()).wait() else {
                // What waits is old by the time there is a connection.
                while self.packets.try_recv().is_ok() {}
                std::thread::park_timeout(PAUSE);
                continue;
            };
            // What was asked for meanwhile is this connection.
            self.shared.renew.store(false, Ordering::Relaxed);
            let receive = receiver(self.sender.clone(), self.flooded.clone());
            let subscriber = session
                .declare_subscriber(&self.keys[1])
                .callback(receive)
                .wait();
            self.shared
                .is_open
                .store(subscriber.is_ok(), Ordering::Relaxed);
            if subscriber.is_ok() {
                self.pass_on(&session);
            }
            self.shared.is_open.store(false, Ordering::Relaxed);
            drop(subscriber);
            let _ = session.close().wait();
        }
    }

    fn pass_on(&self, session: &Session) {
        let is_set = |flag: &AtomicBool| flag.load(Ordering::Relaxed);
        while !is_set(&self.shared.renew) {
            match self.packets.recv_timeout(TURN) {
                Ok(bytes) => {
                    let put = session.put(&self.keys[0], bytes);
                    let _ = put.congestion_control(CongestionControl::Drop).wait();
                }
                Err(RecvTimeoutError::Timeout) if is_set(&self.shared.end) => return,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }
}
