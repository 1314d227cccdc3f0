//! The machine's own floor: a thread that does nothing but wake up.
//!
//! What `cyclictest` measures, in the same minutes as the row beside it: absolute
//! sleeps of the row's period at the controller's priority. What it suffers, no
//! program on this machine could have avoided.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use anyhow::Context;
use hdrhistogram::Histogram;
use rustix::thread::{ClockId, clock_nanosleep_absolute};
use shm_config::services::Process;
use supervisor::table::TABLE;
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

use crate::Clock;
use crate::driven::{Punctuality, Quantiles};

/// A thread that wakes up on a grid, and notes how late.
pub struct Floor {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<anyhow::Result<Punctuality>>,
}

impl Floor {
    /// Starts it at the controller's real-time priority, or without where that
    /// is not granted.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start(rate_hz: f64, clock: Clock) -> anyhow::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let asked = stop.clone();
        let thread = std::thread::Builder::new()
            .name("floor".into())
            .spawn(move || wake(rate_hz, clock, &asked))
            .context("a thread for the machine's floor")?;
        Ok(Self { stop, thread })
    }

    /// Ends it; what it noted.
    ///
    /// # Errors
    /// When its numbers cannot be counted.
    pub fn finish(self) -> anyhow::Result<Punctuality> {
        self.stop.store(true, Ordering::Relaxed);
        match self.thread.join() {
            Ok(noted) => noted,
            Err(_) => anyhow::bail!("the floor's thread died"),
        }
    }
}

fn wake(rate_hz: f64, clock: Clock, stop: &AtomicBool) -> anyhow::Result<Punctuality> {
    let controller = TABLE.iter().find(|row| row.process == Process::Controller);
    let priority = controller.map_or(0, |row| row.priority);
    let granted = ThreadPriority::try_from(priority).is_ok_and(|priority| {
        let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        set_thread_priority_and_policy(thread_native_id(), priority, fifo).is_ok()
    });
    let period_ns = (1e9 / rate_hz) as u64;
    let mut late_us = Histogram::<u64>::new_with_bounds(1, 60_000_000, 3)?;
    let mut due = clock();
    let (mut ticks, mut missed) = (0, 0);
    while !stop.load(Ordering::Relaxed) {
        due = due.after_ns(period_ns);
        let until = due.timespec();
        while clock_nanosleep_absolute(ClockId::Monotonic, &until).is_err() {}
        let late_ns = clock().since_ns(due);
        late_us.saturating_record(late_ns / 1000);
        ticks += 1;
        // Instants that passed meanwhile are missed, as a tick's would be.
        let passed = late_ns / period_ns;
        missed += passed;
        due = due.after_ns(passed * period_ns);
    }
    let at = |quantile: f64| late_us.value_at_quantile(quantile) as f64;
    Ok(Punctuality {
        ticks,
        missed,
        lateness_us: Quantiles {
            p50: at(0.5),
            p99: at(0.99),
            p999: at(0.999),
            max: late_us.max() as f64,
        },
        execution_us: Quantiles::default(),
        priority: match granted {
            true => "granted".into(),
            false => "refused".into(),
        },
    })
}
