use serde::{Deserialize, Serialize};

/// What decides which driver acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GateMode {
    /// The gate process compares both rollouts by exact geometry.
    Rules,
    /// The gate process asks a vision-language model (section `vlm`).
    Vlm,
    /// As in the paper: a question every `period_s`, which names expert and policy, and
    /// the world waits for the answer. Lockstep only. It sets further keys of `gate`,
    /// `vlm` and `controller` (`shm-config/src/config/preset.rs`).
    Paper,
    /// The gate process asks a small net that was distilled from recorded answers
    /// (`distilled`), and a slow judge (`pass_to`) about the scenes that the net does not
    /// know.
    Distilled,
    /// The answers of a recorded run.
    Replay,
    /// Always the expert; no gate process.
    Expert,
    /// Always the policy, if one is loaded; no gate process.
    Policy,
    /// The policy until a person takes over; no gate process.
    Human,
    /// The policy, and the expert in each tick in which their proposals differ by more
    /// than `takeover_steer` or `takeover_pedal`, as the simulated human of PVP4Real takes
    /// over; no gate process.
    Takeover,
}

impl GateMode {
    /// Whether the mode has a process that publishes advice.
    pub fn is_advised(self) -> bool {
        match self {
            Self::Rules | Self::Vlm | Self::Paper | Self::Distilled | Self::Replay => true,
            Self::Expert | Self::Policy | Self::Human | Self::Takeover => false,
        }
    }
}

/// What follows when a tick is done after its deadline, which is one period after it
/// was due.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Late {
    /// The tick is counted; its answer is published.
    Count,
    /// Its answer is not published: its readers use the previous one, up to its age
    /// limit.
    Skip,
    /// The car brakes.
    Brake,
}
