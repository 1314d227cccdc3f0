use shm_config::config::Config;
use shm_config::judged::Judged;

use crate::record::{Record, Verdict};

/// Nothing asked yet, of the configured judge.
pub fn begin(config: &Config) -> Judged {
    let mode = config.gate.mode;
    let judge = match config.gate.asks_model() {
        true => format!(
            "{mode:?}, {} at {}",
            config.vlm.model_name(),
            config.vlm.server
        ),
        false => format!("{mode:?}"),
    };
    Judged {
        judge: judge.to_lowercase(),
        ..Judged::default()
    }
}

/// Counts a record.
pub fn count(judged: &mut Judged, record: &Record) {
    judged.questions += 1;
    judged.cost_usd += record.cost_usd;
    let count = match record.verdict {
        Verdict::Expert => &mut judged.expert,
        Verdict::Policy => &mut judged.policy,
        Verdict::Abstain => &mut judged.abstained,
        Verdict::Failed => &mut judged.failed,
    };
    *count += 1;
    judged.similar += u64::from(record.is_similar());
    if record.verdict == Verdict::Failed {
        let fault = match record.fault.as_str() {
            "" => "unknown",
            fault => fault,
        };
        *judged.faults.entry(fault.into()).or_default() += 1;
    }
}
