use serde::{Deserialize, Serialize};

use super::{OutOfRange, in_range};

/// Placeholder until merged.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Default)]
#[serde(default, deny_unknown_fields)]
pub struct Planner {
    /// Seed of the tree's samples.
    pub seed: u64,
}

impl Planner {
    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        in_range("planner.seed", self.seed, 0..=u64::MAX)
    }
}
