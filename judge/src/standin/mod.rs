//! A server that stands in for one with a vision-language model: for tests, and
//! for work without a network. **It is no model.** It speaks the same protocol
//! over real HTTP, decodes the picture it is sent, and judges by coloured pixels
//! alone which of the two paths that the prompt names is safer; how it sees is
//! up to its [`Eyes`]. On purpose it can be slow, wrong, biased, busy, or break
//! in any way that a server can ([`Mishap`]).

mod door;
mod eyes;
mod mishap;
mod question;
mod routes;

use std::fmt;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng as _, SeedableRng as _};
use tokio::sync::oneshot;
use tokio::time::Instant;

pub use eyes::{Eyes, Middle, Sighting};
pub use mishap::Mishap;

use gate::model::Rate;

/// What the stand-in calls itself, wherever a model would say its name.
pub use shm_config::config::STAND_IN as NAME;

/// How a stand-in is.
#[derive(Clone)]
pub struct Options {
    /// Where it listens, on this machine alone; 0 for any free port.
    pub port: u16,
    /// Time until it answers.
    pub latency: Duration,
    /// Up to so much longer, at random.
    pub jitter: Duration,
    /// Share of its answers that are turned round.
    pub noise: f64,
    /// Share of its answers that are "the first" regardless of the picture.
    pub first_bias: f64,
    /// Share of its answers that are "similar" regardless of the picture.
    pub abstain: f64,
    /// Requests in any 60 s; beyond that, 429 with Retry-After.
    pub rate_per_minute: Option<u32>,
    /// How it breaks.
    pub mishap: Option<Mishap>,
    /// Share of the requests it breaks at.
    pub mishap_share: f64,
    /// Which requests those are, and all else that is drawn.
    pub seed: u64,
    /// How it sees.
    pub eyes: Arc<dyn Eyes>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            port: 0,
            latency: Duration::ZERO,
            jitter: Duration::ZERO,
            noise: 0.0,
            first_bias: 0.0,
            abstain: 0.0,
            rate_per_minute: None,
            mishap: None,
            mishap_share: 1.0,
            seed: 0,
            eyes: Arc::new(Middle),
        }
    }
}

impl fmt::Debug for Options {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter
            .debug_struct("Options")
            .field("port", &self.port)
            .field("mishap", &self.mishap)
            .field("seed", &self.seed)
            .finish_non_exhaustive()
    }
}

/// What all connections share.
struct Shared {
    options: Options,
    random: Mutex<Xoshiro256PlusPlus>,
    rate: Option<Mutex<Rate>>,
    begun: Instant,
    requests: AtomicU64,
    bytes_sent: AtomicU64,
}

impl Shared {
    fn new(options: Options) -> Self {
        Self {
            random: Mutex::new(Xoshiro256PlusPlus::seed_from_u64(options.seed)),
            rate: options
                .rate_per_minute
                .map(|limit| Mutex::new(Rate::new(limit))),
            begun: Instant::now(),
            requests: AtomicU64::new(0),
            bytes_sent: AtomicU64::new(0),
            options,
        }
    }

    /// An even draw from [0, 1).
    fn draw(&self) -> f64 {
        let mut random = self.random.lock().unwrap_or_else(PoisonError::into_inner);
        // 53 bits make a double.
        (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// A stand-in that runs in a thread of its own. Stops when it is dropped.
pub struct Server {
    address: SocketAddr,
    shared: Arc<Shared>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Starts one. Many may run at once.
    ///
    /// # Errors
    /// When the port is taken or no thread can be had.
    pub fn start(options: Options) -> io::Result<Self> {
        let listener = std::net::TcpListener::bind((Ipv4Addr::LOCALHOST, options.port))?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let shared = Arc::new(Shared::new(options));
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        let (stop, stopped) = oneshot::channel();
        let served = shared.clone();
        let thread = std::thread::Builder::new()
            .name("stand-in".into())
            .spawn(move || {
                runtime.block_on(async {
                    let serving = tokio::spawn(serve(listener, served));
                    // Ends when the handle is dropped, whichever way.
                    let _ = stopped.await;
                    serving.abort();
                });
                // A picture that is still examined has no request waiting for it.
                runtime.shutdown_background();
            })?;
        Ok(Self {
            address,
            shared,
            stop: Some(stop),
            thread: Some(thread),
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What `vlm.server` must be to reach it.
    pub fn url(&self) -> String {
        format!("http://{}/v1", self.address)
    }

    /// Questions it was asked, those that it broke at among them.
    pub fn requests(&self) -> u64 {
        self.shared.requests.load(Ordering::Relaxed)
    }

    /// Bytes it has handed to the kernel while it broke.
    pub fn bytes_sent(&self) -> u64 {
        self.shared.bytes_sent.load(Ordering::Relaxed)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // It panicked: the connection of its client is closed.
            let _ = thread.join();
        }
    }
}

async fn serve(listener: std::net::TcpListener, shared: Arc<Shared>) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else {
        return;
    };
    let door = door::open(listener, shared.clone());
    // Ends only when the runtime does.
    let _ = axum::serve(door, routes::router(shared)).await;
}
