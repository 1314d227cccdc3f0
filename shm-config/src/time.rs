//! Instants and clocks.
//!
//! Libraries get `now` as an argument. Only process entry points call
//! [`monotonic`]; clippy refuses it elsewhere.

#[cfg(feature = "wire")]
use rustix::time::{ClockId, Timespec, clock_gettime};

/// Nanoseconds on the run's clock: the machine's monotonic clock in real time,
/// `tick * period` in lockstep.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Instant(pub u64);

impl Instant {
    /// Nanoseconds from `earlier` to this instant; 0 when `earlier` is later.
    pub fn since_ns(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }

    /// This instant moved on by `ns`.
    #[must_use]
    pub fn after_ns(self, ns: u64) -> Self {
        Self(self.0.saturating_add(ns))
    }

    #[cfg(feature = "wire")]
    /// As the kernel's struct, for absolute sleeps.
    pub fn timespec(self) -> Timespec {
        Timespec {
            tv_sec: (self.0 / 1_000_000_000) as i64,
            tv_nsec: (self.0 % 1_000_000_000) as i64,
        }
    }
}

/// A clock that is passed in: `monotonic` in a process, another in a test.
pub type Clock = fn() -> Instant;

/// The machine's monotonic clock: the same for every process, never set back.
#[cfg(feature = "wire")]
#[allow(clippy::disallowed_methods)]
pub fn monotonic() -> Instant {
    let now = clock_gettime(ClockId::Monotonic);
    Instant(now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64)
}
