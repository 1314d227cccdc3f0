//! The record of a run's judge: the gate process writes it, the supervisor shows it. It
//! is a file, so that neither process waits for the other.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::counted;

/// The record's file in the run's folder, JSON.
pub const SUMMARY: &str = "judged.json";

/// Questions and answers of a run, so far.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// The run: the process id of its supervisor.
    pub supervisor: u32,
    /// The judge that was asked.
    pub judge: String,
    /// Questions that are filed; those of the last seconds may be missing.
    pub questions: u64,
    /// Answered for the expert.
    pub expert: u64,
    /// Answered for the policy, "similar" among them.
    pub policy: u64,
    /// Answers for the policy that said neither path is clearly safer; unknown in a
    /// replay.
    pub similar: u64,
    /// Answers without effect, because the replies disagree.
    pub abstained: u64,
    /// Without an answer.
    pub failed: u64,
    /// The faults of the questions without an answer, in one word each.
    pub faults: BTreeMap<String, u64>,
    /// Counts of a distilled net; `None` where none is asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub net: Option<NetCounts>,
    /// Cost, US dollars.
    pub cost_usd: f64,
    /// Records or pictures that could not be stored.
    pub lost: u64,
    /// Why the server got no more questions, for good or for a while, and what to do;
    /// empty if it always got them.
    #[serde(default)]
    pub trouble: String,
}

/// What became of the questions to a distilled net.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetCounts {
    /// Questions that the net answered.
    pub answered: u64,
    /// Questions that it passed on to the slow judge, because it was not sure.
    pub passed_on: u64,
    /// Answers of the net beside which the slow judge answered, too.
    pub audited: u64,
    /// Those of them in which both chose the same driver.
    pub agreed: u64,
}

impl fmt::Display for NetCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the net answered {} and passed on {}; both were asked {} and agreed {}",
            self.answered,
            self.passed_on,
            counted(self.audited, "time"),
            counted(self.agreed, "time")
        )
    }
}

/// The text appended to the answers for the policy, if some of them said "similar".
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
        if let Some(net) = &self.net {
            write!(f, "\n  {net}")?;
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
