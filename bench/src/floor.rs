//! The machine's own floor: a thread that does nothing but wake up.
//!
//! What `cyclictest` measures, in the same minutes as the row beside it: absolute
//! sleeps of the row's period at the controller's priority. What it suffers, no
//! program on this machine could have avoided.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use anyhow::Context;
use rustix::thread::{ClockId, clock_nanosleep_absolute};
use shm_config::Instant;
use shm_config::message::Histogram;
use shm_config::services::Process;
use supervisor::table::{Row, TABLE};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

use crate::Clock;
use crate::driven::{Punctuality, Quantiles};

/// Width of a moment for which the largest lateness is kept, ns.
pub const MOMENT_NS: u64 = 100_000_000;
/// Moments that are kept: an hour, and what a start takes.
const MOMENTS_MAX: usize = 40_000;

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
    /// The largest of each moment.
    pub stalls: Stalls,
}

/// The largest lateness of each tenth of a second.
#[derive(Clone, Debug)]
pub struct Stalls {
    begun: Instant,
    late_ns: Vec<u64>,
}

impl Stalls {
    /// None yet; the memory for all of them is there.
    pub fn from(begun: Instant) -> Self {
        Self {
            begun,
            late_ns: Vec::with_capacity(MOMENTS_MAX),
        }
    }

    /// A wake-up due then came so late: every moment from the instant that was
    /// due to the wake-up had a stall of that length.
    pub fn note(&mut self, due: Instant, late_ns: u64) {
        let first = (due.since_ns(self.begun) / MOMENT_NS) as usize;
        let last = ((due.since_ns(self.begun) + late_ns) / MOMENT_NS) as usize;
        if first >= MOMENTS_MAX {
            return;
        }
        let last = last.min(MOMENTS_MAX - 1);
        if self.late_ns.len() <= last {
            self.late_ns.resize(last + 1, 0);
        }
        for moment in &mut self.late_ns[first..=last] {
            *moment = (*moment).max(late_ns);
        }
    }

    /// The largest lateness within so long of an instant, ns.
    pub fn near(&self, at: Instant, within_ns: u64) -> u64 {
        let from = (at.0.saturating_sub(within_ns)).saturating_sub(self.begun.0) / MOMENT_NS;
        let to = at.after_ns(within_ns).since_ns(self.begun) / MOMENT_NS;
        let moments = self.late_ns.iter().skip(from as usize);
        let moments = moments.take((to - from + 1) as usize);
        moments.copied().max().unwrap_or(0)
    }

    /// The largest few, each with the instant its moment begins at.
    pub fn largest(&self, count: usize) -> Vec<(Instant, u64)> {
        let moments = self.late_ns.iter().enumerate();
        let mut all: Vec<_> = moments
            .map(|(k, &late_ns)| (self.begun.after_ns(k as u64 * MOMENT_NS), late_ns))
            .filter(|&(_, late_ns)| late_ns > 0)
            .collect();
        all.sort_by_key(|&(at, late_ns)| (std::cmp::Reverse(late_ns), at));
        all.truncate(count);
        all
    }
}

/// The controller's row of the process table.
pub fn controller() -> Option<&'static Row> {
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
            .spawn(move || wake((rate_hz, priority), clock, &asked))
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

/// Asks for a real-time priority for the calling thread; the word for what became
/// of it, as the processes say it.
pub fn claim(priority: Priority) -> &'static str {
    if priority == Priority::Ordinary {
        return "not asked";
    }
    let wanted = controller().map_or(0, |row| row.priority);
    let granted = ThreadPriority::try_from(wanted).is_ok_and(|wanted| {
        let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        set_thread_priority_and_policy(thread_native_id(), wanted, fifo).is_ok()
    });
    match granted {
        true => "granted",
        false => "refused",
    }
}

fn wake(
    (rate_hz, priority): (f64, Priority),
    clock: Clock,
    stop: &AtomicBool,
) -> anyhow::Result<Noted> {
    let priority = claim(priority);
    let period_ns = (1e9 / rate_hz) as u64;
    let mut lateness = Box::<Histogram>::default();
    let (mut ticks, mut missed) = (0, 0);
    let mut due = clock();
    let begun = due;
    let mut stalls = Stalls::from(due);
    while !stop.load(Ordering::Relaxed) {
        due = due.after_ns(period_ns);
        let until = due.timespec();
        while clock_nanosleep_absolute(ClockId::Monotonic, &until).is_err() {}
        let late_ns = clock().since_ns(due);
        stalls.note(due, late_ns);
        ticks += 1;
        // Instants that passed meanwhile are missed, as a tick's would be, and as
        // late as they are.
        let passed = late_ns / period_ns;
        lateness.record_series(late_ns % period_ns, period_ns, passed + 1);
        missed += passed;
        due = due.after_ns(passed * period_ns);
    }
    let punctuality = Punctuality {
        ticks,
        skipped: missed,
        missed,
        elapsed_s: due.since_ns(begun) as f64 / 1e9,
        lateness_us: Quantiles::of(&lateness),
        priority: priority.into(),
        ..Punctuality::default()
    };
    Ok(Noted {
        punctuality,
        lateness,
        stalls,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn a_stall_is_found_in_its_moment_and_not_in_others() {
        let begun = Instant(5_000 * MS);
        let mut stalls = Stalls::from(begun);
        stalls.note(begun.after_ns(150 * MS), 7 * MS);
        stalls.note(begun.after_ns(160 * MS), 3 * MS);
        stalls.note(begun.after_ns(2_050 * MS), 120 * MS);
        let near = |ms: u64| stalls.near(begun.after_ns(ms * MS), 50 * MS);
        assert_eq!([near(120), near(400)], [7 * MS, 0]);
        // A long one is in every moment that it lasted.
        assert_eq!([near(2_010), near(2_190)], [120 * MS; 2]);
        let largest = stalls.largest(3);
        assert_eq!(largest[0], (begun.after_ns(2_000 * MS), 120 * MS));
        assert_eq!(largest[2], (begun.after_ns(100 * MS), 7 * MS));
    }
}
