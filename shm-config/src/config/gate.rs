use serde::{Deserialize, Serialize};

use super::{OutOfRange, Run, in_range};

/// Who decides who drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GateMode {
    /// The gate process compares both rollouts by exact geometry.
    Rules,
    /// Always the expert; no gate process.
    Expert,
    /// Always the policy, if one is loaded; no gate process.
    Policy,
    /// The policy until a person takes over; no gate process.
    Human,
}

/// The gate process.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Gate {
    /// Who decides who drives.
    pub mode: GateMode,
    /// Time from question to question, s: `T_vlm` of Sec. 4.2.
    pub period_s: f64,
    /// How long advice holds, s, from the observation it is about. A little over
    /// one period, so that an answer in time leaves no gap.
    pub hold_s: f64,
    /// For experiments: share of the answers that are turned round.
    pub noise: f64,
    /// For experiments: share of the answers that are withheld.
    pub abstention: f64,
    /// For experiments: how long after its question an answer is heard, s.
    pub delay_s: f64,
    /// Which answers those are.
    pub seed: u64,
}

impl Default for Gate {
    fn default() -> Self {
        Self {
            mode: GateMode::Rules,
            period_s: 10.0,
            hold_s: 12.0,
            noise: 0.0,
            abstention: 0.0,
            delay_s: 0.0,
            seed: 0,
        }
    }
}

impl Gate {
    pub(super) fn check(&self, run: &Run) -> Result<(), OutOfRange> {
        if self.mode == GateMode::Human && run.is_lockstep() {
            return Err(OutOfRange {
                key: "gate.mode".into(),
                value: "human".into(),
                expected: "rules, expert or policy in lockstep, which is as fast as the \
                           processes answer: a person cannot keep up"
                    .into(),
            });
        }
        in_range("gate.period_s", self.period_s, 0.001..=3600.0)?;
        in_range("gate.hold_s", self.hold_s, 0.001..=7200.0)?;
        in_range("gate.noise", self.noise, 0.0..=1.0)?;
        in_range("gate.abstention", self.abstention, 0.0..=1.0)?;
        in_range("gate.delay_s", self.delay_s, 0.0..=600.0)
    }

    /// The mode has a process that gives advice.
    pub fn has_process(&self) -> bool {
        match self.mode {
            GateMode::Rules => true,
            GateMode::Expert | GateMode::Policy | GateMode::Human => false,
        }
    }
}
