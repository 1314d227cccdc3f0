//! What a run's judge was asked and said: the gate process writes it down, the
//! supervisor shows it. Both meet in files, so that neither waits on the other.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::counted;

/// The file of it in the run's folder, JSON.
pub const SUMMARY: &str = "judge/summary.json";

/// The file that says which run it is of: the process id of its supervisor.
pub const RUN: &str = "judge/run.txt";

/// Questions and answers of a run, so far.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// Who was asked.
    pub judge: String,
    /// Questions that are filed: those of the last seconds may be missing.
    pub questions: u64,
    /// With a preference for the expert.
    pub expert: u64,
    /// With one for the policy, "similar" among them.
    pub policy: u64,
    /// Of those: neither is clearly safer.
    pub similar: u64,
    /// Without a preference.
    pub abstained: u64,
    /// Without an answer.
    pub failed: u64,
    /// Why, in one word each.
    pub faults: BTreeMap<String, u64>,
    /// US dollars.
    pub cost_usd: f64,
    /// Records or pictures that could not be kept.
    pub lost: u64,
}

impl fmt::Display for Judged {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {}: expert {}, policy {} (of these similar {}), abstained {}, failed {}",
            self.judge,
            counted(self.questions, "question"),
            self.expert,
            self.policy,
            self.similar,
            self.abstained,
            self.failed
        )?;
        if self.cost_usd > 0.0 {
            write!(f, "; {:.4} USD", self.cost_usd)?;
        }
        if !self.faults.is_empty() {
            let faults = self
                .faults
                .iter()
                .map(|(word, count)| format!("{count} {word}"));
            let faults: Vec<String> = faults.collect();
            write!(f, "\n  no answer: {}", faults.join(", "))?;
        }
        if self.lost > 0 {
            write!(f, "\n  {} records or pictures could not be kept", self.lost)?;
        }
        Ok(())
    }
}
