use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use shm_config::config::Config;

use crate::record::{Record, Verdict};

/// What a run's questions came to: `runs/NAME/judge/summary.json`, which the
/// supervisor shows.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// Who is asked.
    pub judge: String,
    /// Questions that are filed.
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
    /// Why, by the word of the fault.
    pub faults: BTreeMap<String, u64>,
    /// US dollars.
    pub cost_usd: f64,
    /// Records that could not be kept.
    pub lost: u64,
}

impl Tally {
    /// Nothing asked yet, of the configured judge.
    pub fn new(config: &Config) -> Self {
        let mode = config.gate.mode;
        let judge = match config.gate.asks_model() {
            true => format!(
                "{mode:?}, {} at {}",
                config.vlm.model_name(),
                config.vlm.server
            ),
            false => format!("{mode:?}"),
        };
        Self {
            judge: judge.to_lowercase(),
            ..Self::default()
        }
    }

    /// Counts a record.
    pub fn count(&mut self, record: &Record) {
        self.questions += 1;
        self.cost_usd += record.cost_usd;
        let count = match record.verdict {
            Verdict::Expert => &mut self.expert,
            Verdict::Policy => &mut self.policy,
            Verdict::Abstain => &mut self.abstained,
            Verdict::Failed => &mut self.failed,
        };
        *count += 1;
        self.similar += u64::from(record.is_similar());
        if record.verdict == Verdict::Failed {
            let fault = match record.fault.as_str() {
                "" => "unknown",
                fault => fault,
            };
            *self.faults.entry(fault.into()).or_default() += 1;
        }
    }
}
