use serde::{Deserialize, Serialize};

/// Why a question is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Occasion {
    /// An episode begins, or a run begins with a new clock.
    Episode,
    /// The period is over: `T_vlm` of Sec. 4.2.
    Period,
    /// The proposals differ by more than the threshold.
    Differ,
    /// The tick's geometry finds little clearance for one of the proposals.
    Clearance,
}
