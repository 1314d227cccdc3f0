//! The machine's own floor: a thread that does nothing but wake up.
//!
//! What `cyclictest` measures, in the same minutes as the row beside it: absolute
//! sleeps of the row's period at the controller's priority. No
//! program on this machine can avoid the lateness that it has.

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

/// Whether the floor asks for the controller's real-time priority.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Priority {
    /// It does, as the controller.
    Asked,
    /// It does not, as a set with `--no-realtime`.
    Ordinary,
}

/// A thread that wakes up on a grid, and notes how late.
pub struct Floor {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<anyhow::Result<Noted>>,
}

/// What a floor's thread noted.
pub struct Noted {
    /// Ticks, and how late they were.
    pub punctuality: Punctuality,
    /// Each lateness, those of missed instants too.
    pub lateness: Box<Histogram>,
}

/// The controller's row of the process table.
pub fn controller() -> Option<&'static ProcessSpec> {
    TABLE.iter().find(|row| row.process == Process::Controller)
}

impl Floor {
    /// Starts it at the controller's real-time priority, or without where that
    /// is not asked for or not granted.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start(rate_hz: f64, priority: Priority, clock: Clock) -> anyhow::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let asked = stop.clone();
        let thread = std::thread::Builder::new()
            .name("floor".into())
            .spawn(move || note((rate_hz, priority), clock, &asked))
            .context("a thread for the machine's floor")?;
        Ok(Self { stop, thread })
    }

    /// Ends it; what it noted.
    ///
    /// # Errors
    /// When its numbers cannot be counted.
    pub fn finish(self) -> anyhow::Result<Noted> {
        self.stop.store(true, Ordering::Relaxed);
        match self.thread.join() {
            Ok(noted) => noted,
            Err(_) => anyhow::bail!("the floor's thread died"),
        }
    }
}

/// The core that a set's controller asks for on this machine; `None` for none.
pub fn controllers_core() -> Option<usize> {
    controller().and_then(|row| Privileges::RealTime(own_cores()).core(row))
}

/// Keeps the calling thread on a core. Refused, it is only noisier.
pub fn stay_on(core: usize) {
    let mut cores = CpuSet::new();
    cores.set(core);
    let _ = sched_setaffinity(None, &cores);
}

/// Asks for the controller's real-time priority for the calling thread; the word
/// for what became of it, as the processes say it.
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

/// Wakes up on a grid from that instant on, until `stop` is set; passes each
/// instant it slept to, and how late it woke, ns. Instants that pass meanwhile are
/// skipped. Returns the last instant of the grid that is past.
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
        // Instants that passed meanwhile are missed, as a tick's would be, and as
        // late as they are.
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
