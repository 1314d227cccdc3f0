//! The thread beside the tick that checks, builds, warms and drops policies.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use policy::{Net, PolicyFile, Refusal, check_answers, check_hash, decode_within, short_hash};
use shm_config::Instant;
use shm_config::config::{Backend, Config};
use shm_config::file;
use shm_config::message::{FEATURES, PolicyState, PolicyStatus, WEIGHTS_BYTES_MAX};
use shm_config::services::Process;
use shm_config::wire::{PUBLISHERS_MAX, Wire, WireError};

use super::good::{Good, GoodFile};
use super::{Begin, Exchange, NativePolicy, News, Offer, OrtPolicy, OrtSession, Policy, library};
use crate::ports::LoaderPorts;

/// From look to look at offers and at the desk. An offer waits half of it on
/// average; 200 looks a second cost well under a thousandth of a core.
const LOOK: Duration = Duration::from_millis(5);
/// Answers of the warm-up: enough for caches and branch predictors, and a median.
const WARM_UP: usize = 64;
/// How long ONNX Runtime is waited for where no deadline is.
const PATIENCE: Duration = Duration::from_secs(10);

/// On which terms weights become a policy.
pub struct Terms<'a> {
    /// Back end, tolerance and limits.
    pub config: &'a Config,
    /// Their version.
    pub version: u64,
    /// How to measure the warm-up.
    pub clock: fn() -> Instant,
}

/// Every check, the session, and its warm-up: bytes to a policy that may go into
/// the tick.
///
/// # Errors
/// The first check that fails.
pub fn build(bytes: &[u8], terms: &Terms) -> Result<Box<dyn Policy>, Refusal> {
    let config = &terms.config.policy;
    let tolerance = config.tolerance as f32;
    let PolicyFile {
        net,
        probes,
        sha256,
        ..
    } = decode_within(bytes, tolerance)?;
    let names = match (net, config.backend) {
        (Net::Mlp { mlp, .. }, Backend::Auto | Backend::Native) => {
            let mut mlp = *mlp;
            warm_up(terms, |features| mlp.infer(features))?;
            return Ok(Box::new(NativePolicy::new(mlp, terms.version, &sha256)));
        }
        (Net::Graph(_), Backend::Native) => {
            return Err(Refusal::NoBackEnd(
                "the net is no chain of Gemm, MatMul, Add, Relu and Tanh, and policy.backend is \
                 native: set it to auto"
                    .into(),
            ));
        }
        (Net::Mlp { names, .. }, Backend::Ort) => names,
        (Net::Graph(names), Backend::Auto | Backend::Ort) => names,
    };
    let mut session = OrtSession::new(&library(&config.onnxruntime)?, bytes, &names)?;
    check_answers(&probes, tolerance, |features| session.infer(features))?;
    warm_up(terms, |features| session.infer(features))?;
    let wait = match terms.config.run.is_lockstep() {
        true => PATIENCE,
        false => Duration::from_nanos((config.ort_wait_us * 1e3) as u64),
    };
    let policy = OrtPolicy::new(session, (terms.version, &sha256), wait, terms.clock)?;
    Ok(Box::new(policy))
}

/// Runs the net until it is warm, and measures it.
fn warm_up(terms: &Terms, mut infer: impl FnMut(&[f32]) -> [f32; 2]) -> Result<(), Refusal> {
    let mut times_ns = [0; WARM_UP];
    for time_ns in &mut times_ns {
        let begun = (terms.clock)();
        std::hint::black_box(infer(&[0.5; FEATURES]));
        *time_ns = (terms.clock)().since_ns(begun);
    }
    times_ns.sort_unstable();
    let median_us = times_ns[WARM_UP / 2] as f64 / 1e3;
    let limit_us = terms.config.policy.inference_max_us;
    // In lockstep what is decided may not depend on how fast the machine is now.
    match median_us > limit_us && !terms.config.run.is_lockstep() {
        true => Err(Refusal::TooSlow {
            median_us,
            limit_us,
        }),
        false => Ok(()),
    }
}

/// The thread, as the process that started it sees it.
pub struct Loader {
    exchange: Arc<Exchange>,
    begun: Receiver<Result<(), String>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Loader {
    /// Starts the thread. Before the process claims its real-time rights: they
    /// are not for it.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start(config: &Config, clock: fn() -> Instant) -> std::io::Result<Self> {
        let exchange = Arc::new(Exchange::default());
        let stop = Arc::new(AtomicBool::new(false));
        let (begin, begun) = channel();
        let (ours, ending, config) = (exchange.clone(), stop.clone(), config.clone());
        let thread = thread::Builder::new()
            .name("loader".into())
            .spawn(move || work(config, clock, ours, &ending, &begin))?;
        Ok(Self {
            exchange,
            begun,
            stop,
            thread: Some(thread),
        })
    }

    /// The desk between the thread and the tick.
    pub fn exchange(&self) -> &Arc<Exchange> {
        &self.exchange
    }

    /// Whether what the run begins with is on the desk; `None` when the time is
    /// over before that is known.
    pub fn begun(&self, wait: Duration) -> Option<Result<(), String>> {
        match self.begun.recv_timeout(wait) {
            Ok(begun) => Some(begun),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => Some(Err("the loader's thread died".into())),
        }
    }
}

impl Drop for Loader {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            let _ = thread.join();
        }
    }
}

fn work(
    config: Config,
    clock: fn() -> Instant,
    exchange: Arc<Exchange>,
    stop: &AtomicBool,
    begin: &Sender<Result<(), String>>,
) {
    let ports = match Ports::open(&config) {
        Ok(ports) => ports,
        // Without ports there is nobody to load for.
        Err(error) => return drop(begin.send(Err(error.to_string()))),
    };
    let mut bench = Bench {
        good: GoodFile::new(&config.run.folder),
        config,
        clock,
        exchange,
        ports,
        status: PolicyStatus::default(),
        known: Vec::new(),
    };
    let _ = begin.send(bench.begin());
    while !stop.load(Ordering::Relaxed) {
        bench.take_offers();
        bench.clear_desk();
        bench.ports.wire.status.tend();
        thread::park_timeout(LOOK);
    }
    bench.clear_desk();
}

/// The loader joins the run by itself: ports belong to one thread.
struct Ports {
    wire: LoaderPorts,
    _member: Wire,
}

impl Ports {
    fn open(config: &Config) -> Result<Self, WireError> {
        let failed =
            |error: shm_config::run::InvalidRunName| WireError::port("run", error.to_string());
        let wire = Wire::join(
            &config.run.name.parse().map_err(failed)?,
            Process::Controller,
        )?;
        Ok(Self {
            wire: LoaderPorts::open(&wire)?,
            _member: wire,
        })
    }
}

/// What the thread works with.
struct Bench {
    config: Config,
    clock: fn() -> Instant,
    exchange: Arc<Exchange>,
    ports: Ports,
    status: PolicyStatus,
    good: GoodFile,
    /// Files of weights that may still come into charge, or back into it.
    known: Vec<Good>,
}

/// An offer, out of shared memory.
struct Received {
    version: u64,
    sha256: [u8; 32],
    byte_count: u64,
    bytes: Vec<u8>,
}

impl Bench {
    /// What the run begins with: the weights that were good, for a controller
    /// that was restarted or a run that resumes, else those of `policy.file`.
    fn begin(&mut self) -> Result<(), String> {
        self.publish();
        let chosen = &self.config.policy;
        let resumes = chosen.resume && chosen.file.is_empty() && !self.config.run.is_lockstep();
        let good = match resumes || self.good.is_of_this_run() {
            true => self.good.read(),
            false => None,
        };
        if let Some(good) = good {
            match self.put(&good, Begin::Settled) {
                Ok(()) => return Ok(()),
                Err(refusal) => {
                    tracing::warn!(%refusal, "the weights that were good are not used");
                }
            }
        }
        if self.config.policy.file.is_empty() {
            return Ok(());
        }
        let path = PathBuf::from(&self.config.policy.file);
        let bytes = read_limited(&path).map_err(|why| format!("{}: {why}", path.display()))?;
        let good = Good { version: 1, bytes };
        self.put(&good, Begin::Shadow)
            .map_err(|refusal| format!("{}: {refusal}", path.display()))
    }

    /// Checks weights and puts them on the desk.
    fn put(&mut self, weights: &Good, begin: Begin) -> Result<(), Refusal> {
        let policy = build(
            &weights.bytes,
            &Terms {
                config: &self.config,
                version: weights.version,
                clock: self.clock,
            },
        )?;
        self.status.offered_version = weights.version;
        self.status.offered_hash = policy.hash();
        // Until the tick has taken it up.
        self.status.state = PolicyState::Empty.code();
        self.status.set_refusal("");
        self.known.retain(|known| known.version != weights.version);
        self.known.push(weights.clone());
        let before = match self.exchange.desk.lock() {
            Ok(mut desk) => desk.offer.replace(Offer { policy, begin }),
            Err(_) => None,
        };
        // One that nobody has taken yet is dropped here, outside the lock.
        drop(before);
        self.exchange.decide(weights.version);
        Ok(())
    }

    fn take_offers(&mut self) {
        self.ports.wire.weights.tend();
        // As many publishers as there may be, so that none holds the loop.
        for _ in 0..PUBLISHERS_MAX {
            let received = self.ports.wire.weights.visit(|weights| Received {
                version: weights.version,
                sha256: weights.sha256,
                byte_count: weights.byte_count,
                bytes: weights.file().to_vec(),
            });
            match received {
                Some(received) => self.consider(received),
                None => return,
            }
        }
    }

    fn consider(&mut self, offer: Received) {
        let decided = self.exchange.decided();
        let hash = short_hash(&offer.sha256);
        if offer.version <= decided {
            // A publisher's last message comes again to whoever is restarted. A
            // publisher whose number another took first sees that in the status.
            tracing::info!(
                version = offer.version,
                decided,
                "an offer that is not newer"
            );
            self.publish();
            return;
        }
        let weights = Good {
            version: offer.version,
            bytes: offer.bytes,
        };
        let is_whole = match offer.byte_count > WEIGHTS_BYTES_MAX as u64 {
            true => Err(Refusal::TooLarge {
                bytes: offer.byte_count,
                limit: WEIGHTS_BYTES_MAX as u64,
            }),
            false => check_hash(&weights.bytes, &offer.sha256),
        };
        if let Err(refusal) = is_whole.and_then(|()| self.put(&weights, Begin::Shadow)) {
            self.refuse((weights.version, hash), &refusal.to_string());
            // Decided last: who waits for the decision finds it said.
            self.exchange.decide(weights.version);
        }
    }

    fn refuse(&mut self, (version, hash): (u64, u64), reason: &str) {
        tracing::warn!(version, reason, "weights refused");
        self.status.offered_version = version;
        self.status.offered_hash = hash;
        self.status.state = PolicyState::Refused.code();
        self.status.set_refusal(reason);
        self.publish();
    }

    /// Drops what came back and tells what was said.
    fn clear_desk(&mut self) {
        let (returned, news, first_tick) = match self.exchange.desk.lock() {
            Ok(mut desk) => {
                // A restarted controller goes on with the numbers of its world: from
                // which tick on it has the weights is known after its first one.
                let news = match desk.first_tick {
                    Some(_) => std::mem::take(&mut desk.news),
                    None => Default::default(),
                };
                (std::mem::take(&mut desk.returned), news, desk.first_tick)
            }
            Err(_) => return,
        };
        drop(returned);
        for news in news.into_iter().flatten() {
            self.tell(news, first_tick.unwrap_or(0));
        }
    }

    /// Nothing is done at tick 0 but what was done before the first tick.
    fn tell(&mut self, news: News, first_tick: u64) {
        let number = |tick| if tick == 0 { first_tick } else { tick };
        match news {
            News::Adopted { version, tick } => {
                let tick = number(tick);
                tracing::info!(version, tick, "weights adopted");
                self.status.header.tick = tick;
                self.status.adopted_tick = tick;
                self.enter(version, PolicyState::Shadow, "");
            }
            News::Promoted { version, tick } => {
                let tick = number(tick);
                tracing::info!(version, tick, "weights may drive");
                self.charge(version);
                self.status.header.tick = tick;
                self.enter(version, PolicyState::Ready, "");
                // What is older than those before cannot come back.
                let count = self.known.len();
                self.known.drain(..count.saturating_sub(3));
            }
            News::RolledBack {
                version,
                tick,
                fault,
                charged: (charged, _),
            } => {
                let reason = format!("rolled back at tick {tick}: {fault}");
                tracing::warn!(version, tick, %fault, "weights rolled back");
                self.known.retain(|known| known.version != version);
                self.charge(charged);
                self.status.header.tick = tick;
                self.enter(version, PolicyState::RolledBack, &reason);
            }
        }
    }

    /// These weights are in charge, and are what a restart begins with.
    fn charge(&mut self, version: u64) {
        let known = self.known.iter().find(|known| known.version == version);
        self.status.version = version;
        self.status.hash = known.map_or(0, |known| short_hash(&policy::sha256(&known.bytes)));
        let kept = self.good.write(known);
        self.status.unkept = u64::from(kept.is_err());
        if let Err(error) = kept {
            tracing::warn!(%error, "the weights in charge cannot be kept for a restart");
        }
    }

    /// The state is that of the last offer; others may come into charge or go
    /// while it waits.
    fn enter(&mut self, version: u64, state: PolicyState, reason: &str) {
        if version == self.status.offered_version {
            self.status.state = state.code();
            self.status.set_refusal(reason);
        }
        self.publish();
    }

    fn publish(&mut self) {
        self.status.header.taken_ns = (self.clock)().0;
        self.ports.wire.status.send(&mut self.status);
    }
}

/// A file that fits into an offer.
fn read_limited(path: &std::path::Path) -> Result<Vec<u8>, String> {
    let bytes = file::regular(path)
        .map_err(|error| error.to_string())?
        .len();
    let limit = WEIGHTS_BYTES_MAX as u64;
    if bytes > limit {
        return Err(Refusal::TooLarge { bytes, limit }.to_string());
    }
    file::read(path, limit).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_file_is_refused_and_not_waited_for() {
        for path in ["/dev/null", "/"] {
            let refusal = read_limited(path.as_ref()).expect_err(path);
            assert!(refusal.contains("is no regular file"), "{path}: {refusal}");
        }
    }
}
