//! The thread beside the tick that checks, builds, warms and drops policies.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use policy::{Refusal, check_hash, short_hash};
use shm_config::config::Config;
use shm_config::file;
use shm_config::message::{PolicyState, PolicyStatus, WEIGHTS_BYTES_MAX};
use shm_config::services::Process;
use shm_config::time::Clock;
use shm_config::wire::{PUBLISHERS_MAX, Wire, WireError};

use super::last_good::{LastGood, LastGoodFile};
use super::mailbox::{Candidate, Mailbox, SwapEvent};
use super::{StartStage, Terms, build};
use crate::ports::LoaderPorts;

/// Interval at which offers and the mailbox are polled. An offer waits half of it on
/// average; 200 polls a second cost well under a thousandth of a core.
const POLL: Duration = Duration::from_millis(5);
/// The thread, as the process that started it sees it.
pub struct Loader {
    mailbox: Arc<Mailbox>,
    begun: Receiver<Result<(), String>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Loader {
    /// Starts the thread. Before the process applies its real-time privileges: the
    /// thread must not inherit them.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start(config: &Config, clock: Clock) -> std::io::Result<Self> {
        let mailbox = Arc::new(Mailbox::default());
        let stop = Arc::new(AtomicBool::new(false));
        let (begin, begun) = channel();
        let (ours, ending, config) = (mailbox.clone(), stop.clone(), config.clone());
        let thread = thread::Builder::new()
            .name("loader".into())
            .spawn(move || work(config, clock, ours, &ending, &begin))?;
        Ok(Self {
            mailbox,
            begun,
            stop,
            thread: Some(thread),
        })
    }

    /// The mailbox between the thread and the tick.
    pub fn mailbox(&self) -> &Arc<Mailbox> {
        &self.mailbox
    }

    /// Whether the run's first policy is in the mailbox; `None` when the time is
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
    clock: Clock,
    mailbox: Arc<Mailbox>,
    stop: &AtomicBool,
    begin: &Sender<Result<(), String>>,
) {
    let ports = match Ports::open(&config) {
        Ok(ports) => ports,
        // Without ports no policy can be offered.
        Err(error) => return drop(begin.send(Err(error.to_string()))),
    };
    let mut worker = Worker {
        good: LastGoodFile::new(&config.run.folder),
        config,
        clock,
        mailbox,
        ports,
        status: PolicyStatus::default(),
        known: Vec::new(),
    };
    let _ = begin.send(worker.begin());
    while !stop.load(Ordering::Relaxed) {
        worker.take_offers();
        worker.empty_mailbox();
        worker.ports.wire.status.update_connections();
        thread::park_timeout(POLL);
    }
    worker.empty_mailbox();
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
struct Worker {
    config: Config,
    clock: Clock,
    mailbox: Arc<Mailbox>,
    ports: Ports,
    status: PolicyStatus,
    good: LastGoodFile,
    /// Files of weights that may still become active, or active again.
    known: Vec<LastGood>,
}

/// An offer, out of shared memory.
struct Received {
    version: u64,
    sha256: [u8; 32],
    byte_count: u64,
    bytes: Vec<u8>,
}

impl Worker {
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
            match self.put(&good, StartStage::Settled) {
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
        let good = LastGood { version: 1, bytes };
        self.put(&good, StartStage::Shadow)
            .map_err(|refusal| format!("{}: {refusal}", path.display()))
    }

    /// Checks weights and puts them into the mailbox.
    fn put(&mut self, weights: &LastGood, start: StartStage) -> Result<(), Refusal> {
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
        let before = match self.mailbox.contents.lock() {
            Ok(mut contents) => contents.candidate.replace(Candidate { policy, start }),
            Err(_) => None,
        };
        // One that was not taken yet is dropped here, outside the lock.
        drop(before);
        self.mailbox.decide(weights.version);
        Ok(())
    }

    fn take_offers(&mut self) {
        self.ports.wire.weights.update_connections();
        // At most one offer of each possible publisher, so that none blocks the loop.
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
        let decided = self.mailbox.decided();
        let hash = short_hash(&offer.sha256);
        if offer.version <= decided {
            // A restarted reader receives a publisher's last message again. A publisher
            // whose number another took first sees that in the status.
            tracing::info!(
                version = offer.version,
                decided,
                "an offer that is not newer"
            );
            self.publish();
            return;
        }
        let weights = LastGood {
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
        if let Err(refusal) = is_whole.and_then(|()| self.put(&weights, StartStage::Shadow)) {
            self.refuse((weights.version, hash), &refusal.to_string());
            // Decided last: the status is published before the wait for it ends.
            self.mailbox.decide(weights.version);
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

    /// Drops the policies that came back and reports the events.
    fn empty_mailbox(&mut self) {
        let (returned, events, first_tick) = match self.mailbox.contents.lock() {
            Ok(mut contents) => {
                // A restarted controller goes on with the numbers of its world: from
                // which tick on it has the weights is known after its first one.
                let events = match contents.first_tick {
                    Some(_) => std::mem::take(&mut contents.events),
                    None => Default::default(),
                };
                let returned = std::mem::take(&mut contents.returned);
                (returned, events, contents.first_tick)
            }
            Err(_) => return,
        };
        drop(returned);
        for event in events.into_iter().flatten() {
            self.report(event, first_tick.unwrap_or(0));
        }
    }

    /// Tick 0 stands for what happened before the first tick.
    fn report(&mut self, event: SwapEvent, first_tick: u64) {
        let number = |tick| if tick == 0 { first_tick } else { tick };
        match event {
            SwapEvent::Adopted { version, tick } => {
                let tick = number(tick);
                tracing::info!(version, tick, "weights adopted");
                self.status.header.tick = tick;
                self.status.adopted_tick = tick;
                self.enter(version, PolicyState::Shadow, "");
            }
            SwapEvent::Promoted { version, tick } => {
                let tick = number(tick);
                tracing::info!(version, tick, "weights may drive");
                self.activate(version);
                self.status.header.tick = tick;
                self.enter(version, PolicyState::Ready, "");
                // What is older than those before cannot come back.
                let count = self.known.len();
                self.known.drain(..count.saturating_sub(3));
            }
            SwapEvent::RolledBack {
                version,
                tick,
                fault,
                active: (active, _),
            } => {
                let reason = format!("rolled back at tick {tick}: {fault}");
                tracing::warn!(version, tick, %fault, "weights rolled back");
                self.known.retain(|known| known.version != version);
                self.activate(active);
                self.status.header.tick = tick;
                self.enter(version, PolicyState::RolledBack, &reason);
            }
        }
    }

    /// These weights are active, and a restart begins with them.
    fn activate(&mut self, version: u64) {
        let known = self.known.iter().find(|known| known.version == version);
        self.status.version = version;
        self.status.hash = known.map_or(0, |known| short_hash(&policy::sha256(&known.bytes)));
        let kept = self.good.write(known);
        self.status.unkept = u64::from(kept.is_err());
        if let Err(error) = kept {
            tracing::warn!(%error, "the active weights cannot be kept for a restart");
        }
    }

    /// The state is that of the last offer; other weights may become active or be
    /// dropped while it waits.
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
