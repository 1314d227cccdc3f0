use serde::{Deserialize, Serialize};

use super::{OutOfRange, in_range};

/// The learner process.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Learner {
    /// A learner is part of the run.
    pub enabled: bool,
    /// In lockstep: after so many steps the controller waits until the learner
    /// has considered them all, and until what it published is adopted or
    /// refused.
    pub block_steps: u32,
    /// In lockstep: how long the controller waits for it, s on the machine's
    /// clock; then a silent learner is not waited for until it speaks again.
    pub lockstep_wait_s: f64,
}

impl Default for Learner {
    fn default() -> Self {
        Self {
            enabled: false,
            // 20 s of driving at the paper's 10 Hz.
            block_steps: 200,
            // A block of updates takes seconds; a busy machine, ten times that.
            lockstep_wait_s: 120.0,
        }
    }
}

impl Learner {
    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        in_range("learner.block_steps", self.block_steps, 1..=1_000_000)?;
        in_range(
            "learner.lockstep_wait_s",
            self.lockstep_wait_s,
            0.01..=36_000.0,
        )
    }
}
