//! The pause before a restart, and when to give up.

use shm_config::config::Supervisor;

/// The restarts of one process.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Backoff {
    restarts: u32,
    in_row: u32,
}

/// What follows the death of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum After {
    /// Restart it when this has passed, ns.
    Pause(u64),
    /// It has been restarted as often as allowed.
    GiveUp,
}

impl Backoff {
    /// Restarts so far.
    pub fn restarts(&self) -> u32 {
        self.restarts
    }

    /// Decides after the process died, having run for `ran_ns`; counts the restart if one
    /// follows.
    pub fn died(&mut self, ran_ns: u64, limits: &Supervisor) -> After {
        if self.restarts >= limits.restarts_max {
            return After::GiveUp;
        }
        if ran_ns as f64 >= limits.healthy_s * 1e9 {
            self.in_row = 0;
        }
        // 2^63 ms is beyond any limit; a larger exponent would overflow to infinity.
        let doubled_ms = limits.backoff_ms * 2f64.powi(self.in_row.min(63) as i32);
        self.restarts += 1;
        self.in_row = self.in_row.saturating_add(1);
        After::Pause((doubled_ms.min(limits.backoff_max_ms) * 1e6) as u64)
    }
}
