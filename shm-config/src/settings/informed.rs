use serde::{Deserialize, Serialize};

use super::planner::DISC_CELLS_MAX;
use super::{OutOfRange, in_range};

/// Informed RRT* with a memory, `planner.method = "informed"`. All other settings are
/// those of `planner`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Informed {
    /// Replaces `planner.inflation_m`, m. 1.2: half the car's width (0.926 m), the
    /// safety check's margin of 0.15 m, and 12 cm for the tracking error.
    pub inflation_m: f64,
    /// A plan older than this is not used again, s. 0.5: five ticks of the paper's 0.1
    /// s, in which the car moves by one step of the tree.
    #[serde(skip)]
    pub memory_s: f64,
}

impl Default for Informed {
    fn default() -> Self {
        Self {
            inflation_m: 1.2,
            memory_s: 0.5,
        }
    }
}

impl Informed {
    /// Checks every number, the inflation against the grid's cell, m.
    ///
    /// # Errors
    /// The first number that is not finite or outside its limits.
    pub fn check(&self, cell_m: f64) -> Result<(), OutOfRange> {
        let disc_m = cell_m * DISC_CELLS_MAX as f64;
        in_range("informed.inflation_m", self.inflation_m, 0.0..=disc_m)?;
        in_range("informed.memory_s", self.memory_s, 0.0..=10.0)
    }
}
