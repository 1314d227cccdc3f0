//! The machine's floor: the wake-up lateness of a thread that does nothing else.
//!
//! This is what `cyclictest` measures: absolute sleeps of the row's period at the
//! controller's priority, in the same minutes as the row beside it. No program on
//! this machine can be less late.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use anyhow::Context;
use rustix::thread::{ClockId, CpuSet, clock_nanosleep_absolute, sched_setaffinity};
use shm_config::Instant;
use shm_config::message::Histogram;
use shm_config::services::Process;
use supervisor::machine::cores::own_cores;
use supervisor::set::privileges::Privileges;
use supervisor::set::table::{ProcessSpec, TABLE};

use crate::driven::{Punctuality, Quantiles};
use stack::Clock;

/// Whether a thread requests the controller's real-time priority.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Priority {
    /// It requests it, as the controller does.
    Asked,
    /// It does not, as in a set with `--no-realtime`.
    Ordinary,
}

/// A thread that wakes up on a grid and records its lateness.
pub struct Floor {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<anyhow::Result<Noted>>,
}

/// What the floor's thread measured.
pub struct Noted {
    /// Ticks and quantiles of their lateness.
    pub punctuality: Punctuality,
    /// Every lateness, missed instants included.
    pub lateness: Box<Histogram>,
}

/// The controller's row of the process table.
pub fn controller() -> Option<&'static ProcessSpec> {
    TABLE.iter().find(|row| row.process == Process::Controller)
}

impl Floor {
    /// Starts the thread at the controller's real-time priority, or without it where it
    /// is not requested or not granted.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn start(rate_hz: f64, priority: Priority, clock: Clock) -> anyhow::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let asked = stop.clone();
        let thread = std::thread::Builder::new()
            .name("floor".into())
            .spawn(move || note((rate_hz, priority), clock, &asked))
            .context("a thread for the machine's floor")?;
        Ok(Self { stop, thread })
    }

    /// Stops the thread and returns its measurement.
    ///
    /// # Errors
    /// If its counts do not fit into the histogram.
    pub fn finish(self) -> anyhow::Result<Noted> {
        self.stop.store(true, Ordering::Relaxed);
        match self.thread.join() {
            Ok(noted) => noted,
            Err(_) => anyhow::bail!("the floor's thread died"),
        }
    }
}

/// The core that a set's controller requests on this machine; `None` without a core.
pub fn controllers_core() -> Option<usize> {
    controller().and_then(|row| Privileges::RealTime(own_cores()).core(row))
}

/// Pins the calling thread to a core. If that is refused, the measurement is noisier.
pub fn stay_on(core: usize) {
    let mut cores = CpuSet::new();
    cores.set(core);
    let _ = sched_setaffinity(None, &cores);
}

/// Requests the controller's real-time priority for the calling thread. Returns the
/// result in the words of the run's summary: granted, refused or not asked.
pub fn claim(priority: Priority) -> &'static str {
    match priority {
        Priority::Ordinary => "not asked",
        Priority::Asked => {
            let wanted = controller().map_or(0, |row| row.priority);
            match runtime::set_fifo(wanted.into()) {
                Ok(()) => "granted",
                Err(_) => "refused",
            }
        }
    }
}

/// Wakes up on a grid that begins at `from`, until `stop` is set. Calls back with each
/// scheduled instant and its lateness, ns. Instants that pass during a late wake-up
/// are skipped. Returns the last instant of the grid that has passed.
pub fn wake(
    begun: Instant,
    period_ns: u64,
    clock: Clock,
    stop: &AtomicBool,
    mut woken: impl FnMut(Instant, u64),
) -> Instant {
    let mut due = begun;
    while !stop.load(Ordering::Relaxed) {
        due = due.after_ns(period_ns);
        let until = due.timespec();
        while clock_nanosleep_absolute(ClockId::Monotonic, &until).is_err() {}
        let late_ns = clock().since_ns(due);
        woken(due, late_ns);
        due = due.after_ns(late_ns / period_ns * period_ns);
    }
    due
}

fn note(
    (rate_hz, priority): (f64, Priority),
    clock: Clock,
    stop: &AtomicBool,
) -> anyhow::Result<Noted> {
    let priority = claim(priority);
    if let Some(core) = controllers_core().filter(|_| priority == "granted") {
        stay_on(core);
    }
    let period_ns = (1e9 / rate_hz) as u64;
    let mut lateness = Box::<Histogram>::default();
    let (mut ticks, mut missed) = (0, 0);
    let begun = clock();
    let last = wake(begun, period_ns, clock, stop, |_, late_ns| {
        ticks += 1;
        // Instants that passed during a late wake-up count as missed, as the ticks of a
        // controller do, each with its own lateness.
        let passed = late_ns / period_ns;
        lateness.record_series(late_ns % period_ns, period_ns, passed + 1);
        missed += passed;
    });
    let punctuality = Punctuality {
        ticks,
        skipped: missed,
        missed,
        elapsed_s: last.since_ns(begun) as f64 / 1e9,
        lateness_us: Quantiles::of(&lateness),
        priority: priority.into(),
        ..Punctuality::default()
    };
    Ok(Noted {
        punctuality,
        lateness,
    })
}
