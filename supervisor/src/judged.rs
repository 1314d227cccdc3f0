//! What a run's judge was asked and said, as the gate process has written it down.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use shm_config::config::Config;

/// Longest file that is read, bytes.
const BYTES_MAX: u64 = 1 << 16;

/// Questions and answers of a run, so far.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

impl Judged {
    /// Of a run in this folder whose supervisor has this process id; `None` where
    /// nobody judges, or nothing is written down.
    pub fn read(config: &Config, folder: &Path, supervisor: u32) -> Option<Self> {
        if !config.gate.has_process() {
            return None;
        }
        let folder = folder.join("judge");
        let run = fs::read_to_string(folder.join("run.txt")).ok()?;
        if run != supervisor.to_string() {
            return None;
        }
        let path = folder.join("summary.json");
        if fs::metadata(&path).ok()?.len() > BYTES_MAX {
            return None;
        }
        serde_json::from_str(&fs::read_to_string(path).ok()?).ok()
    }
}

impl fmt::Display for Judged {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {} questions: expert {}, policy {} (of these similar {}), abstained {}, failed {}",
            self.judge,
            self.questions,
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
