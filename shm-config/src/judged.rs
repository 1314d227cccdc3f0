//! What a run's judge was asked and said: the gate process writes it down, the
//! supervisor shows it. Both meet in files, so that neither waits on the other.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::counted;

/// The file of it in the run's folder, JSON.
pub const SUMMARY: &str = "judged.json";

/// Questions and answers of a run, so far.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// Which run it is of: the process id of its supervisor.
    pub supervisor: u32,
    /// Who was asked.
    pub judge: String,
    /// Questions that are filed: those of the last seconds may be missing.
    pub questions: u64,
    /// Answered for the expert.
    pub expert: u64,
    /// Answered for the policy, "similar" among them.
    pub policy: u64,
    /// Of those: neither is clearly safer. Of a replay nobody knows.
    pub similar: u64,
    /// Without an answer that counts: the replies disagree.
    pub abstained: u64,
    /// Without an answer.
    pub failed: u64,
    /// Why, in one word each.
    pub faults: BTreeMap<String, u64>,
    /// US dollars.
    pub cost_usd: f64,
    /// Records or pictures that could not be kept.
    pub lost: u64,
    /// Why the server was not asked any more, for good or for a while, and what to
    /// do; empty where it always was.
    #[serde(default)]
    pub trouble: String,
}

/// What is added to the answers for the policy, where there were such.
pub fn of_these_similar(similar: u64) -> String {
    match similar {
        0 => String::new(),
        _ => format!(" (of these similar {similar})"),
    }
}

impl fmt::Display for Judged {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {}: expert {}, policy {}{}, abstained {}, failed {}",
            self.judge,
            counted(self.questions, "question"),
            self.expert,
            self.policy,
            of_these_similar(self.similar),
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
        if !self.trouble.is_empty() {
            write!(f, "\n  warning: {}", self.trouble)?;
        }
        Ok(())
    }
}
