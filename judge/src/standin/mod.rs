//! A server that stands in for a vision-language model, for tests and for work without a
//! network. **It is not a model.** It speaks the same protocol over real HTTP, decodes
//! the picture, and decides by the colours of its pixels which of the two paths in the
//! prompt is safer; its [`PathRater`] make that decision. It can inject delay, label noise,
//! bias, abstention, rate limits and every server fault ([`ServerFault`]).

mod injector;
mod question;
mod rater;
mod routes;
mod server_fault;

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

pub use rater::{MiddleRule, PathRater, Rating};
pub use server_fault::ServerFault;

use gate::model::Rate;

/// The name that the stand-in reports as its model.
pub use shm_config::config::STAND_IN as NAME;

/// Options of a stand-in.
#[derive(Clone)]
pub struct Options {
    /// Port on 127.0.0.1; 0 for any free port.
    pub port: u16,
    /// Delay of each answer.
    pub latency: Duration,
    /// Maximum additional random delay.
    pub jitter: Duration,
    /// Share of answers that are inverted.
    pub noise: f64,
    /// Share of answers that are "the first" regardless of the picture.
    pub first_bias: f64,
    /// Share of answers that are "similar" regardless of the picture.
    pub abstain: f64,
    /// Maximum number of requests in any 60 s; further ones get 429 with Retry-After.
    pub rate_per_minute: Option<u32>,
    /// Fault to inject.
    pub injected: Option<ServerFault>,
    /// Share of the requests with the fault.
    pub injected_share: f64,
    /// Seed of all random draws.
    pub seed: u64,
    /// The rules that compare the paths.
    pub rater: Arc<dyn PathRater>,
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
            injected: None,
            injected_share: 1.0,
            seed: 0,
            rater: Arc::new(MiddleRule),
        }
    }
}

impl fmt::Debug for Options {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter
            .debug_struct("Options")
            .field("port", &self.port)
            .field("injected", &self.injected)
            .field("seed", &self.seed)
            .finish_non_exhaustive()
    }
}

/// State shared by all connections.
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

    /// A uniform draw from [0, 1).
    fn draw(&self) -> f64 {
        let mut random = self.random.lock().unwrap_or_else(PoisonError::into_inner);
        // A double has 53 bits of precision.
        (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// A stand-in that runs in its own thread; dropping it stops it.
pub struct Server {
    address: SocketAddr,
    shared: Arc<Shared>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Starts a stand-in. Several may run at once.
    ///
    /// # Errors
    /// If the port is taken or no thread can be started.
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
                    // Ends when the handle is dropped.
                    let _ = stopped.await;
                    serving.abort();
                });
                // No request waits for pictures that are still being examined.
                runtime.shutdown_background();
            })?;
        Ok(Self {
            address,
            shared,
            stop: Some(stop),
            thread: Some(thread),
        })
    }

    /// The address it listens on.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The value of `vlm.server` for this stand-in.
    pub fn url(&self) -> String {
        format!("http://{}/v1", self.address)
    }

    /// Number of requests so far, including those with a fault.
    pub fn requests(&self) -> u64 {
        self.shared.requests.load(Ordering::Relaxed)
    }

    /// Bytes that faults have sent so far.
    pub fn bytes_sent(&self) -> u64 {
        self.shared.bytes_sent.load(Ordering::Relaxed)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // The thread panicked: its clients' connections are closed.
            let _ = thread.join();
        }
    }
}

async fn serve(listener: std::net::TcpListener, shared: Arc<Shared>) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else {
        return;
    };
    let door = injector::open(listener, shared.clone());
    // Runs until the runtime ends.
    let _ = axum::serve(door, routes::router(shared)).await;
}
