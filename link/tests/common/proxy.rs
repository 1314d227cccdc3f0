//! A network that fails, between two ends of a TCP connection: delay with jitter, packets that
//! come late as after a loss, silence as of a cable that is cut, and resets.

#![allow(dead_code)] // each test program uses a part
#![allow(clippy::disallowed_methods)] // a network takes time

use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;

/// How the network is now.
#[derive(Default)]
pub struct Network {
    /// Every chunk comes later by this, ms.
    pub delay_ms: AtomicU64,
    /// And by up to this, ms.
    pub jitter_ms: AtomicU64,
    /// This share of the chunks is lost and sent again after `LATE_MS`, percent.
    pub lost_percent: AtomicU64,
    /// Bytes that pass in a second in each direction; 0 for any number.
    pub bytes_per_s: AtomicU64,
    /// Nothing passes, and nothing is said: the connection stays half open.
    pub is_cut: AtomicBool,
    /// All connections are reset.
    resets: AtomicU64,
    end: AtomicBool,
}

/// A slow network holds what passes in this time, ms; then its sender waits.
const HELD_MS: u64 = 100;
/// The time until TCP sends a lost segment again, ms.
const LATE_MS: u64 = 250;

/// A proxy.
pub struct Proxy {
    /// Where it listens.
    pub address: String,
    /// Its network.
    pub network: Arc<Network>,
}

impl Proxy {
    /// Passes on to an address.
    pub fn new(to: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("an address").to_string();
        let network = Arc::new(Network::default());
        let (shared, to) = (network.clone(), to.to_string());
        std::thread::spawn(move || {
            for (number, stream) in listener.incoming().flatten().enumerate() {
                if shared.end.load(Ordering::Relaxed) {
                    return;
                }
                let Ok(other) = TcpStream::connect(&to) else {
                    continue;
                };
                let pairs = [(&stream, &other), (&other, &stream)];
                for (way, (from, to)) in pairs.into_iter().enumerate() {
                    let clone = |stream: &TcpStream| stream.try_clone().expect("a stream");
                    pump(
                        (clone(from), clone(to)),
                        shared.clone(),
                        (number * 2 + way) as u64,
                    );
                }
            }
        });
        Self { address, network }
    }

    /// Resets all connections.
    pub fn reset(&self) {
        self.network.resets.fetch_add(1, Ordering::Relaxed);
    }

    /// Sets delay, jitter and loss.
    pub fn set(&self, [delay_ms, jitter_ms, lost_percent]: [u64; 3]) {
        self.network.delay_ms.store(delay_ms, Ordering::Relaxed);
        self.network.jitter_ms.store(jitter_ms, Ordering::Relaxed);
        self.network
            .lost_percent
            .store(lost_percent, Ordering::Relaxed);
    }

    /// Sets how much passes.
    pub fn slow(&self, bytes_per_s: u64) {
        self.network
            .bytes_per_s
            .store(bytes_per_s, Ordering::Relaxed);
    }

    /// Cuts the cable, or joins it again.
    pub fn cut(&self, is_cut: bool) {
        self.network.is_cut.store(is_cut, Ordering::Relaxed);
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.network.end.store(true, Ordering::Relaxed);
        let _ = TcpStream::connect(&self.address);
    }
}

fn pump((mut from, mut to): (TcpStream, TcpStream), network: Arc<Network>, seed: u64) {
    let (sender, receiver) = channel::<(Instant, Vec<u8>)>();
    let _ = from.set_read_timeout(Some(Duration::from_millis(20)));
    let _ = to.set_nodelay(true);
    let shared = network.clone();
    let begun = network.resets.load(Ordering::Relaxed);
    std::thread::spawn(move || {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut due = Instant::now();
        let mut free = due;
        let mut bytes = vec![0; 16 << 10];
        while !shared.end.load(Ordering::Relaxed) && shared.resets.load(Ordering::Relaxed) == begun
        {
            let waits = free.saturating_duration_since(Instant::now());
            if waits > Duration::from_millis(HELD_MS) {
                std::thread::park_timeout(Duration::from_millis(1));
                continue;
            }
            let count = match from.read(&mut bytes) {
                Ok(0) => break,
                Ok(count) => count,
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => continue,
                Err(_) => break,
            };
            let get = |value: &AtomicU64| value.load(Ordering::Relaxed);
            let mut late_ms =
                get(&shared.delay_ms) + random.random_range(0..=get(&shared.jitter_ms));
            if random.random_range(0..100) < get(&shared.lost_percent) {
                late_ms += LATE_MS;
            }
            if let rate @ 1.. = get(&shared.bytes_per_s) {
                free = free.max(Instant::now())
                    + Duration::from_micros(count as u64 * 1_000_000 / rate);
                due = due.max(free);
            }
            due = due.max(Instant::now() + Duration::from_millis(late_ms));
            if sender.send((due, bytes[..count].to_vec())).is_err() {
                break;
            }
        }
        let _ = from.shutdown(Shutdown::Both);
    });
    std::thread::spawn(move || {
        for (due, bytes) in receiver {
            while network.is_cut.load(Ordering::Relaxed) || Instant::now() < due {
                if network.end.load(Ordering::Relaxed) {
                    return;
                }
                let left = due.saturating_duration_since(Instant::now());
                std::thread::park_timeout(
                    left.clamp(Duration::from_micros(100), Duration::from_millis(5)),
                );
            }
            if to.write_all(&bytes).is_err() {
                break;
            }
        }
        let _ = to.shutdown(Shutdown::Both);
    });
}
