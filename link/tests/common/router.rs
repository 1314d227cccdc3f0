//! A router between two namespaces, below TCP: it reads IP packets from an interface in one
//! and writes them to that in the other. On the way it loses, delays, reorders and doubles
//! them. Where the kernel has no `netem`, this is what stands for it.

#![allow(dead_code)] // each test program uses a part
#![allow(clippy::disallowed_methods)] // a network takes time

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::ffi::c_int;
use std::fs::File;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use rustix::ioctl::{Opcode, Updater, ioctl, opcode};

use crate::namespaces::{Namespaces, run};

/// Longest packet: an interface has 1,500 bytes at most without an option.
const PACKET_BYTES: usize = 2048;
/// How long the writer waits for a packet, when none is on the way.
const WAIT: Duration = Duration::from_millis(100);

/// How the network is now, in both directions alike.
#[derive(Default)]
pub struct Network {
    /// Every packet comes later by this, ms.
    pub delay_ms: AtomicU64,
    /// And by up to this, ms; so packets overtake each other.
    pub jitter_ms: AtomicU64,
    /// This share is lost, percent.
    pub lost_percent: AtomicU64,
    /// This share is held back for `held_ms`, percent.
    pub held_percent: AtomicU64,
    /// See `held_percent`.
    pub held_ms: AtomicU64,
    /// This share comes twice, percent.
    pub doubled_percent: AtomicU64,
    /// Nothing passes, and nothing is said.
    pub is_cut: AtomicBool,
    /// Packets that came to the router.
    pub came: AtomicU64,
    /// Packets that it lost.
    pub lost: AtomicU64,
    /// Packets that it passed on twice.
    pub doubled: AtomicU64,
    /// Packets that it passed on after a later one.
    pub overtaken: AtomicU64,
}

impl Network {
    /// Sets delay and jitter, ms; the share that is lost; the share that is held back and for
    /// how many ms; and the share that is doubled.
    pub fn set(&self, to: [u64; 6]) {
        let all = [
            &self.delay_ms,
            &self.jitter_ms,
            &self.lost_percent,
            &self.held_percent,
            &self.held_ms,
            &self.doubled_percent,
        ];
        for (value, to) in all.into_iter().zip(to) {
            value.store(to, Ordering::Relaxed);
        }
    }

    pub fn cut(&self, is_cut: bool) {
        self.is_cut.store(is_cut, Ordering::Relaxed);
    }

    /// Packets that came, were lost, doubled, overtaken.
    pub fn counts(&self) -> [u64; 4] {
        [&self.came, &self.lost, &self.doubled, &self.overtaken]
            .map(|count| count.load(Ordering::Relaxed))
    }
}

/// A packet with the instant at which it is passed on, and its number.
type OnTheWay = Reverse<(Instant, u64, Vec<u8>)>;

/// A router.
pub struct Router {
    /// Its network.
    pub network: Arc<Network>,
    spaces: Namespaces,
    seed: u64,
    threads: Vec<JoinHandle<()>>,
}

/// What `TUNSETIFF` takes, the kernel's `struct ifreq`.
#[repr(C)]
struct Request {
    name: [u8; 16],
    flags: u16,
    unused: [u8; 22],
}
const _: () = assert!(size_of::<Request>() == 40);
const TUNSETIFF: Opcode = opcode::write::<c_int>(b'T', 202);
/// IP packets, and nothing before them.
const IFF_TUN_NO_PI: u16 = 0x1001;

/// Makes an interface, which ends with the file.
fn interface(name: &str) -> io::Result<File> {
    let file = File::options()
        .read(true)
        .write(true)
        .open("/dev/net/tun")?;
    let mut request = Request {
        name: [0; 16],
        flags: IFF_TUN_NO_PI,
        unused: [0; 22],
    };
    request.name[..name.len()].copy_from_slice(name.as_bytes());
    // SAFETY: `TUNSETIFF` reads and writes a `struct ifreq`, of which `Request` has the size
    // and the layout.
    #[allow(unsafe_code)]
    unsafe {
        ioctl(&file, Updater::<TUNSETIFF, _>::new(&mut request))?;
    }
    Ok(file)
}

impl Router {
    /// Connects two namespaces that have no network.
    ///
    /// # Errors
    /// What this machine does not permit.
    pub fn new(seed: u64) -> Result<Self, String> {
        let mut router = Self {
            network: Arc::default(),
            spaces: Namespaces::new(2)?,
            seed,
            threads: Vec::new(),
        };
        router.start()?;
        Ok(router)
    }

    /// Makes its interfaces and passes packets on.
    ///
    /// # Errors
    /// What this machine does not permit.
    pub fn start(&mut self) -> Result<(), String> {
        let mut ends = Vec::new();
        for place in [0, 1] {
            let name = self.spaces.interface(place);
            let made = interface(&name).map_err(|error| format!("/dev/net/tun: {error}"))?;
            let to = &self.spaces.names[place];
            run(&["ip", "link", "set", &name, "netns", to])?;
            self.spaces.set_up(place)?;
            ends.push(Arc::new(made));
        }
        for (way, [from, to]) in [[0, 1], [1, 0]].into_iter().enumerate() {
            let (sender, receiver) = channel();
            let (from, to) = (ends[from].clone(), ends[to].clone());
            let networks = [self.network.clone(), self.network.clone()];
            let [reading, writing] = networks;
            let random = Xoshiro256PlusPlus::seed_from_u64(self.seed * 2 + way as u64);
            let threads = [
                std::thread::spawn(move || read(&from, &reading, &sender, random)),
                std::thread::spawn(move || write(&to, &writing, &receiver)),
            ];
            self.threads.extend(threads);
        }
        Ok(())
    }

    /// Ends it: its interfaces are gone, with what was on the way.
    pub fn kill(&mut self) {
        for place in [0, 1] {
            let name = self.spaces.interface(place);
            let _ = self.spaces.ip(place, &format!("link del {name}"));
        }
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }

    /// The vehicle's namespace and the other one.
    pub fn stage(&self) -> Option<crate::sets::Stage> {
        self.spaces.stage(0, 1)
    }
}

impl Drop for Router {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Decides what becomes of each packet, until the interface is gone.
fn read(
    mut from: &File,
    network: &Network,
    sender: &Sender<OnTheWay>,
    mut random: Xoshiro256PlusPlus,
) {
    let mut bytes = [0; PACKET_BYTES];
    for number in 0.. {
        let count = match from.read(&mut bytes) {
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Err(_) => return,
        };
        let get = |value: &AtomicU64| value.load(Ordering::Relaxed);
        let mut happens = |percent: &AtomicU64| random.random_range(0..100) < get(percent);
        network.came.fetch_add(1, Ordering::Relaxed);
        if happens(&network.lost_percent) || network.is_cut.load(Ordering::Relaxed) {
            network.lost.fetch_add(1, Ordering::Relaxed);
            continue;
        }
        let is_doubled = happens(&network.doubled_percent);
        network
            .doubled
            .fetch_add(is_doubled.into(), Ordering::Relaxed);
        for _ in 0..1 + u32::from(is_doubled) {
            let is_held = random.random_range(0..100) < get(&network.held_percent);
            let late_ms = get(&network.delay_ms)
                + random.random_range(0..=get(&network.jitter_ms))
                + u64::from(is_held) * get(&network.held_ms);
            let due = Instant::now() + Duration::from_millis(late_ms);
            if sender
                .send(Reverse((due, number, bytes[..count].to_vec())))
                .is_err()
            {
                return;
            }
        }
    }
}

/// Passes each packet on at its instant, until the reader has ended.
fn write(mut to: &File, network: &Network, receiver: &Receiver<OnTheWay>) {
    let mut waiting: BinaryHeap<OnTheWay> = BinaryHeap::new();
    let mut last = 0;
    loop {
        let now = Instant::now();
        let wait = match waiting.peek() {
            Some(Reverse((due, ..))) => due.saturating_duration_since(now),
            None => WAIT,
        };
        match receiver.recv_timeout(wait) {
            Ok(packet) => waiting.push(packet),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        let now = Instant::now();
        while waiting.peek().is_some_and(|Reverse((due, ..))| *due <= now)
            && let Some(Reverse((_, number, bytes))) = waiting.pop()
        {
            let is_gone = network.is_cut.load(Ordering::Relaxed) || to.write(&bytes).is_err();
            network.lost.fetch_add(is_gone.into(), Ordering::Relaxed);
            let is_late = number < last;
            network
                .overtaken
                .fetch_add(is_late.into(), Ordering::Relaxed);
            last = last.max(number);
        }
    }
}
