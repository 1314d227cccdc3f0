//! The recorder process: one thread drains shared memory into a bounded ring, one writes.
//!
//! Neither makes a tick late: publishers never wait for a reader, and the thread that
//! drains never waits for the disk. A message that finds a full queue or ring is lost,
//! counted by service and named.

mod by_hand;
mod date;
mod drain;
mod facts;
mod files;
mod flight;
mod losses;
mod policies;
mod ring;
mod session;
mod shown;
mod storage;
mod triggers;
mod writing;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

use runtime::{Arguments, Member, SetUpError, Telemetry, Tick};
use shm_config::config::{Config, Keep};
use shm_config::message::{HealthState, Kept};
use shm_config::services::{KEPT, Process};
use shm_config::time::monotonic;
use shm_config::wire::Wire;
use shm_config::{Instant, counted, file};

use drain::{Drain, DrainOptions, MayWait, WhenFull};
use files::{Enclosed, Files};
use flight::Flight;
use losses::Losses;
use policies::Offers;
use writing::{Shared, Sink, Writing, Written};

pub use by_hand::{ByHand, by_hand, write_now};

use crate::Channel;
use session::RecordingFolder;
use shown::Shown;

shm_config::ports! {
    /// What the recorder publishes; it reads each row that is recorded.
    pub struct Ports of Recorder {
        /// How far it is.
        kept: write KEPT: Kept,
    }
}

/// How long a thread that has nothing to do sleeps.
const PATIENCE: Duration = Duration::from_millis(20);
/// Longest time from turn to turn of the drain, in real time, ns.
const TURN_NS: u64 = 20_000_000;
/// In lockstep, where a tick takes less than a millisecond.
const LOCKSTEP_TURN: Duration = Duration::from_millis(1);
/// Messages of a service that may come from turn to turn: a quarter of what its queue holds.
const TURN_MESSAGES: f64 = 16.0;
/// Longest time that the other processes are waited for at the end, ns.
const OTHERS_NS: u64 = 4_000_000_000;
/// Time between two lines about losses, ns.
const LOSS_REPORT_NS: u64 = 5_000_000_000;
/// A disk that has taken nothing for so long hangs, ns.
const DISK_HANGS_NS: u64 = 1_000_000_000;
/// Bytes of the largest policy file and configuration that are read.
const FILE_MAX: u64 = 64 << 20;

/// Records the run of the configuration, as a process of its set, until it ends.
///
/// # Errors
/// When the process cannot be set up.
#[allow(clippy::disallowed_methods)] // a process entry point reads the clock
pub fn run(arguments: &Arguments) -> Result<(), SetUpError> {
    // First: an order to write would end a process that does not expect it.
    let shared = Shared::open()?;
    let member = Member::join(Process::Recorder, arguments, monotonic)?;
    let own = |error: &dyn std::fmt::Display| SetUpError::Own(error.to_string());
    let supervisor = parent();
    let config = &member.config;
    let place = RecordingFolder::of_run(config, supervisor).map_err(|error| own(&error))?;
    let judge = config
        .gate
        .asks_world()
        .then(|| PathBuf::from(&config.run.folder).join("judge"));
    let parts = Parts {
        keep: config.keeps(),
        judge,
        supervisor,
        place,
        shared,
    };
    let mut telemetry = Telemetry::start(&member)?;
    telemetry.set_privileges(&member.privileges);
    let mut recorder = Recorder::start(config, &member.wire, parts)?;
    telemetry.enter(HealthState::Ready, monotonic());
    let mut kept = match recorder.is_lockstep {
        true => Some(Ports::open(&member.wire)?),
        false => None,
    };
    let mut asked = None;
    loop {
        let begun = monotonic();
        // In lockstep it waits for the disk as long as it takes, and for a moment once it is
        // asked to stop.
        let any = recorder.turn(begun, &mut || {
            let now = monotonic();
            telemetry.heartbeat(now);
            !member.is_stopping() || now.since_ns(*asked.get_or_insert(now)) <= OTHERS_NS
        });
        if let Some(kept) = &mut kept {
            recorder.tell_kept(kept, any);
        }
        telemetry.health.lost = recorder.lost();
        telemetry.health.state = HealthState::Running.code();
        telemetry.count_tick(Tick {
            due: begun,
            released: None,
            begun,
            done: monotonic(),
        });
        telemetry.heartbeat(begun);
        if member.is_stopping() {
            // The last messages of the others are recorded, too.
            let asked = *asked.get_or_insert(begun);
            let others = others_live(&member.wire, supervisor);
            if begun.since_ns(asked) > OTHERS_NS || !(any || others) {
                break;
            }
        }
        recorder.rest(any);
    }
    // Writing what is left may take as long as the supervisor's patience.
    let ended = recorder.finish(|| telemetry.heartbeat(monotonic()));
    telemetry.health.lost = ended.losses.total();
    telemetry.enter(HealthState::Finished, monotonic());
    tell(&ended);
    Ok(())
}

/// What a recorder is made of.
struct Parts {
    keep: Keep,
    judge: Option<PathBuf>,
    supervisor: u32,
    place: RecordingFolder,
    shared: Arc<Shared>,
}

/// Both threads.
struct Recorder {
    drain: Drain,
    writing: JoinHandle<Written>,
    shared: Arc<Shared>,
    turn: Duration,
    is_lockstep: bool,
    told: (u64, Instant),
    /// Messages lost when the disk's thread was last told.
    shared_lost: u64,
}

/// What a recording has, and what it lacks.
struct Ended {
    written: Written,
    losses: Losses,
}

impl Recorder {
    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn start(config: &Config, wire: &Wire, parts: Parts) -> Result<Self, SetUpError> {
        let is_lockstep = config.run.is_lockstep();
        let offset_ns = match is_lockstep {
            true => epoch_ns(),
            false => epoch_ns().saturating_sub(monotonic().0),
        };
        let offset_ns = parts.place.offset_ns.unwrap_or(offset_ns);
        let (into, out) = ring::ring(ring::RING_BYTES);
        let shared = parts.shared.clone();
        let from_start = parts.place.from_start;
        let (theirs, config_copy) = (shared.clone(), config.clone());
        let writing = std::thread::Builder::new()
            .name("disk".into())
            // It hashes the programs first, while messages wait in the ring.
            .spawn(move || writing(&config_copy, parts, offset_ns, out).run(&theirs))
            .map_err(|error| SetUpError::Own(format!("cannot start a thread: {error}")))?;
        let options = DrainOptions {
            when_full: match is_lockstep {
                true => WhenFull::Wait,
                false => WhenFull::Drop,
            },
            is_lockstep,
            from_start,
        };
        let drain = Drain::open(wire, (into, writing.thread().clone()), options)?;
        Ok(Self {
            drain,
            writing,
            shared,
            turn: turn(config),
            is_lockstep,
            told: (0, Instant(0)),
            shared_lost: 0,
        })
    }

    /// Drains once; returns whether there was anything.
    fn turn(&mut self, now: Instant, may_wait: MayWait<'_>) -> bool {
        let any = self.drain.turn(now, may_wait);
        let lost = self.lost();
        if lost > self.told.0 && now.since_ns(self.told.1) > LOSS_REPORT_NS {
            let losses = self.drain.losses();
            match self.disk_hangs_ns(now) {
                0 => tracing::warn!(lost, "messages are not in the recording: {losses}"),
                hangs_ns => tracing::warn!(
                    lost,
                    disk_hangs_s = hangs_ns / 1_000_000_000,
                    "messages are not in the recording: {losses}"
                ),
            }
            self.told = (lost, now);
        }
        // The disk's thread reads it when it completes a file; it never makes this one wait.
        if lost > self.shared_lost
            && let Ok(mut before_disk) = self.shared.before_disk.try_lock()
        {
            before_disk.clone_from(self.drain.losses());
            self.shared_lost = lost;
        }
        any
    }

    /// For how long the disk's thread has not gone on, ns; 0 below a second, or while it has
    /// not begun.
    fn disk_hangs_ns(&self, now: Instant) -> u64 {
        match self.shared.alive_ns.load(Ordering::Relaxed) {
            0 => 0,
            alive_ns => Some(now.since_ns(Instant(alive_ns)))
                .filter(|ns| *ns >= DISK_HANGS_NS)
                .unwrap_or_default(),
        }
    }

    /// Tells the controller of a run in lockstep how far it may go on.
    fn tell_kept(&self, ports: &mut Ports, any: bool) {
        ports.update_connections();
        if any {
            let mut kept = Kept::default();
            kept.header.tick = self.drain.step_tick;
            kept.steps = self.drain.steps;
            ports.kept.send(&mut kept);
        }
    }

    fn rest(&self, any: bool) {
        // In lockstep the next messages come at once.
        if !(self.is_lockstep && any) {
            std::thread::park_timeout(self.turn);
        }
    }

    fn lost(&self) -> u64 {
        let refused = self.shared.refused.load(Ordering::Relaxed);
        self.drain.losses().total().saturating_add(refused)
    }

    /// Writes what is in memory, and completes the files; calls `wait` again and again
    /// meanwhile.
    fn finish(self, mut wait: impl FnMut()) -> Ended {
        let mut losses = self.drain.losses().clone();
        if let Ok(mut before_disk) = self.shared.before_disk.lock() {
            before_disk.clone_from(&losses);
        }
        self.shared.end.store(true, Ordering::Release);
        self.writing.thread().unpark();
        while !self.writing.is_finished() {
            wait();
            std::thread::park_timeout(PATIENCE);
        }
        let written = self.writing.join().unwrap_or_default();
        losses.merge(&written.losses);
        Ended { written, losses }
    }
}

/// What the writing thread works with.
#[allow(clippy::disallowed_methods)] // a process entry point reads the clock
fn writing(config: &Config, parts: Parts, offset_ns: u64, ring: ring::RingOut) -> Writing {
    let origin = facts::origin(config, parts.supervisor, offset_ns);
    let mut channels = Channel::recorded();
    let shown = Shown::wanted(config, offset_ns, &mut channels);
    let enclosed = enclosed(config);
    let offers = Offers::new(enclosed.policies.clone());
    let storage = parts.place.storage;
    let sink = match parts.keep {
        Keep::Flight => Sink::Flight(Flight::new(storage, origin, channels.clone(), enclosed)),
        _ => {
            let mut files = Files::new(storage, origin, channels.clone(), enclosed);
            if parts.judge.is_some() {
                files.reserve_for_attachments();
            }
            Sink::Files(files)
        }
    };
    Writing {
        ring,
        sink,
        channels,
        shown,
        clock: monotonic,
        judge: parts.judge,
        offers,
    }
}

/// Until the next turn: a quarter of what the smallest queue holds.
fn turn(config: &Config) -> Duration {
    if config.run.is_lockstep() {
        return LOCKSTEP_TURN;
    }
    let rates = Process::ALL
        .iter()
        .filter_map(|process| config.rate_hz(*process));
    let fastest_hz = rates.fold(1.0, f64::max);
    let turn_ns = (1e9 * TURN_MESSAGES / fastest_hz) as u64;
    Duration::from_nanos(turn_ns.min(TURN_NS))
}

/// What every file of this run has beside messages.
fn enclosed(config: &Config) -> Enclosed {
    let configuration = toml_of(config);
    let path = PathBuf::from(&config.policy.file);
    let mut policies = Vec::new();
    if !config.policy.file.is_empty()
        && let Ok(bytes) = file::read(&path, FILE_MAX)
    {
        policies.push((session::sha256(&bytes), bytes.into()));
    }
    Enclosed {
        configuration,
        policies,
    }
}

fn toml_of(config: &Config) -> String {
    let path = std::path::Path::new(&config.run.folder).join(crate::CONFIGURATION);
    file::read_text(&path, FILE_MAX).unwrap_or_default()
}

fn parent() -> u32 {
    let parent = rustix::process::getppid();
    parent.map_or(0, |pid| pid.as_raw_nonzero().get().unsigned_abs())
}

/// Whether a process of the run beside the recorder and the supervisor lives.
fn others_live(wire: &Wire, supervisor: u32) -> bool {
    let own = std::process::id();
    let pids = Process::ALL
        .iter()
        .filter_map(|process| wire.named(*process));
    let others = pids.filter(|pid| *pid != own && *pid != supervisor);
    others
        .filter_map(|pid| rustix::process::Pid::from_raw(i32::try_from(pid).ok()?))
        .any(|pid| rustix::process::test_kill_process(pid).is_ok())
}

/// Epoch time, ns.
#[allow(clippy::disallowed_methods)] // a process entry point reads the clock
fn epoch_ns() -> u64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    since.map_or(0, |since| since.as_nanos() as u64)
}

fn text(ended: &Ended) -> String {
    let Written {
        messages,
        files,
        bytes,
        folder,
        ..
    } = &ended.written;
    let (messages, files) = (counted(*messages, "message"), counted(*files, "file"));
    let lost = match ended.losses.is_empty() {
        true => "none lost".to_string(),
        false => format!("{} lost ({})", ended.losses.total(), ended.losses),
    };
    let folder = folder.display();
    format!("{messages} in {files} of {bytes} bytes in {folder}, {lost}")
}

fn tell(ended: &Ended) {
    match ended.losses.is_empty() {
        true => tracing::info!("recorded: {}", text(ended)),
        false => tracing::warn!("recorded: {}", text(ended)),
    }
}
