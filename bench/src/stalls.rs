//! Stalls of the machine, measured by one thread per core that only wakes up.
//!
//! On a virtual machine the host takes one core away at a time. A thread without
//! core affinity is woken on another core and does not see the stall; a thread that
//! is bound to the core, or was running on it, waits. Therefore each core has its
//! own thread with a priority above all of the set: only the machine can make it late.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use anyhow::Context;
use rustix::thread::{CpuSet, sched_getaffinity};
use shm_config::Instant;
use supervisor::set::table::TABLE;

use crate::floor::{Priority, stay_on, wake};
use stack::Clock;

/// Width of one time bucket, ns; the largest lateness of each bucket is kept.
pub const BUCKET_NS: u64 = 100_000_000;
/// Number of buckets: one hour plus the time that a start takes.
const BUCKETS_MAX: usize = 40_000;
/// Wake-up period, ns.
const PERIOD_NS: u64 = 1_000_000;

/// The largest lateness in each bucket of 0.1 s.
#[derive(Clone, Debug)]
pub struct Stalls {
    begun: Instant,
    late_ns: Vec<u64>,
}

impl Stalls {
    /// Starts without stalls; allocates memory for all buckets.
    pub fn from(begun: Instant) -> Self {
        Self {
            begun,
            late_ns: Vec::with_capacity(BUCKETS_MAX),
        }
    }

    /// Records a wake-up that was due at `due` and came `late_ns` late: every bucket
    /// from `due` to the wake-up gets at least this lateness.
    pub fn note(&mut self, due: Instant, late_ns: u64) {
        let first = (due.since_ns(self.begun) / BUCKET_NS) as usize;
        let last = ((due.since_ns(self.begun) + late_ns) / BUCKET_NS) as usize;
        if first >= BUCKETS_MAX {
            return;
        }
        let last = last.min(BUCKETS_MAX - 1);
        if self.late_ns.len() <= last {
            self.late_ns.resize(last + 1, 0);
        }
        for bucket in &mut self.late_ns[first..=last] {
            *bucket = (*bucket).max(late_ns);
        }
    }

    /// The largest lateness within `within_ns` of an instant, ns.
    pub fn near(&self, at: Instant, within_ns: u64) -> u64 {
        let from = (at.0.saturating_sub(within_ns)).saturating_sub(self.begun.0) / BUCKET_NS;
        let to = at.after_ns(within_ns).since_ns(self.begun) / BUCKET_NS;
        let buckets = self.late_ns.iter().skip(from as usize);
        let buckets = buckets.take((to - from + 1) as usize);
        buckets.copied().max().unwrap_or(0)
    }

    /// The larger lateness of both, bucket by bucket.
    pub fn max_with(mut self, other: &Self) -> Self {
        let count = self.late_ns.len().max(other.late_ns.len());
        self.late_ns.resize(count, 0);
        for (bucket, &late_ns) in self.late_ns.iter_mut().zip(&other.late_ns) {
            *bucket = (*bucket).max(late_ns);
        }
        self
    }

    /// The `count` largest, each with the instant at which its bucket begins.
    pub fn largest(&self, count: usize) -> Vec<(Instant, u64)> {
        let buckets = self.late_ns.iter().enumerate();
        let mut all: Vec<_> = buckets
            .map(|(k, &late_ns)| (self.begun.after_ns(k as u64 * BUCKET_NS), late_ns))
            .filter(|&(_, late_ns)| late_ns > 0)
            .collect();
        all.sort_by_key(|&(at, late_ns)| (std::cmp::Reverse(late_ns), at));
        all.truncate(count);
        all
    }
}

/// One thread per core that records its wake-up lateness.
pub struct StallWatch {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<Stalls>>,
}

impl StallWatch {
    /// Starts a thread on every core that this process may use; at real-time priority
    /// where that is requested and granted.
    ///
    /// # Errors
    /// If a thread cannot be started.
    pub fn start(priority: Priority, clock: Clock) -> anyhow::Result<Self> {
        let allowed = sched_getaffinity(None).context("the cores of this process")?;
        let stop = Arc::new(AtomicBool::new(false));
        let begun = clock();
        let mut watch = Self {
            stop,
            threads: Vec::new(),
        };
        for core in (0..CpuSet::MAX_CPU).filter(|&core| allowed.is_set(core)) {
            let stop = watch.stop.clone();
            let thread = std::thread::Builder::new()
                .name(format!("stalls-{core}"))
                .spawn(move || note(core, priority, begun, clock, &stop))
                .context("a thread that notes stalls")?;
            watch.threads.push(thread);
        }
        Ok(watch)
    }

    /// Stops the threads and returns the largest stall of any core per bucket.
    ///
    /// # Errors
    /// If one of the threads has died.
    pub fn finish(mut self) -> anyhow::Result<Stalls> {
        self.stop.store(true, Ordering::Relaxed);
        let mut all = None::<Stalls>;
        for thread in self.threads.drain(..) {
            let Ok(of_core) = thread.join() else {
                anyhow::bail!("a thread that notes stalls died");
            };
            all = Some(match all {
                Some(all) => all.max_with(&of_core),
                None => of_core,
            });
        }
        all.context("no core to note stalls of")
    }
}

impl Drop for StallWatch {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

fn note(
    core: usize,
    priority: Priority,
    begun: Instant,
    clock: Clock,
    stop: &AtomicBool,
) -> Stalls {
    // If the core has gone offline meanwhile, the thread runs on any core.
    stay_on(core);
    if priority == Priority::Asked {
        let of_set = TABLE.iter().map(|row| row.priority).max();
        // Without the priority, waiting behind the set's own threads is recorded as stall, too.
        let _ = runtime::set_fifo(u32::from(of_set.unwrap_or(0)) + 1);
    }
    let mut stalls = Stalls::from(begun);
    wake(begun, PERIOD_NS, clock, stop, |due, late_ns| {
        stalls.note(due, late_ns);
    });
    stalls
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
        // A long stall is in every bucket that it covers.
        assert_eq!([near(2_010), near(2_190)], [120 * MS; 2]);
        let mut elsewhere = Stalls::from(begun);
        elsewhere.note(begun.after_ns(400 * MS), 9 * MS);
        let both = elsewhere.max_with(&stalls);
        assert_eq!(both.near(begun.after_ns(400 * MS), 0), 9 * MS);
        assert_eq!(both.near(begun.after_ns(2_190 * MS), 0), 120 * MS);
        let largest = stalls.largest(3);
        assert_eq!(largest[0], (begun.after_ns(2_000 * MS), 120 * MS));
        assert_eq!(largest[2], (begun.after_ns(100 * MS), 7 * MS));
    }
}
