//! Measurements of this program itself: time, processor time, memory.

use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};
use shm_config::Instant;
use stack::Clock;
use stats_alloc::INSTRUMENTED_SYSTEM;

/// Reads the clock and the counters. The memory counters are those of the program's
/// allocator, [`INSTRUMENTED_SYSTEM`], as in `vlaps-bench`; elsewhere they are 0.
#[derive(Clone, Copy, Debug)]
pub struct Gauges {
    clock: Clock,
}

impl Gauges {
    /// With the program's clock.
    pub fn new(clock: Clock) -> Gauges {
        Gauges { clock }
    }

    /// The time now.
    pub fn now(self) -> Instant {
        (self.clock)()
    }

    /// The program's clock.
    pub fn clock(self) -> Clock {
        self.clock
    }

    /// Processor time of this thread so far.
    #[allow(clippy::disallowed_methods)] // a measurement: no decision depends on it
    pub fn core(self) -> Duration {
        let now = clock_gettime(ClockId::ThreadCPUTime);
        Duration::new(now.tv_sec.unsigned_abs(), now.tv_nsec.unsigned_abs() as u32)
    }

    /// Allocations and reallocations so far.
    pub fn allocations(self) -> usize {
        let stats = INSTRUMENTED_SYSTEM.stats();
        stats.allocations + stats.reallocations
    }

    /// Bytes of the heap in use.
    pub fn bytes_held(self) -> usize {
        let stats = INSTRUMENTED_SYSTEM.stats();
        stats
            .bytes_allocated
            .saturating_sub(stats.bytes_deallocated)
    }
}
