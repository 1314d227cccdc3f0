use serde::{Deserialize, Serialize};

/// What decides which driver acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GateMode {
    /// The gate process compares both rollouts by exact geometry.
    Rules,
    /// The gate process asks a vision-language model (section `vlm`).
    Vlm,
    /// The same as the paper did it: a question every `period_s`, expert and
    /// policy named, and the world waits for the answer. Lockstep only. It sets
    /// further keys of `gate`, `vlm` and `controller` (`Config::with_preset`).
    Paper,
    /// The answers of a run that was recorded.
    Replay,
    /// Always the expert; no gate process.
    Expert,
    /// Always the policy, if one is loaded; no gate process.
    Policy,
    /// The policy until a person takes over; no gate process.
    Human,
}

impl GateMode {
    /// The mode has a process that gives advice.
    pub fn is_advised(self) -> bool {
        match self {
            Self::Rules | Self::Vlm | Self::Paper | Self::Replay => true,
            Self::Expert | Self::Policy | Self::Human => false,
        }
    }
}

/// What follows when a tick is done after its deadline, one period after it was
/// due.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Late {
    /// It is counted; its answer goes out all the same.
    Count,
    /// Its answer is held back: its readers go on with the one before, up to
    /// its age limit.
    Skip,
    /// The car brakes.
    Brake,
}
