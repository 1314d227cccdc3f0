use shm_config::config::{Config, GateMode};
use shm_config::judged::Judged;
use shm_config::message::Preference;

use super::{Record, Said};

/// Counts at zero, for the configured judge in the run of this supervisor.
pub fn begin(config: &Config, supervisor: u32) -> Judged {
    let mode = format!("{:?}", config.gate.mode).to_lowercase();
    let judge = match config.gate.mode {
        _ if config.gate.asks_model() => {
            let (model, server) = (config.vlm.model_name(), &config.vlm.server);
            format!("{mode}, {model} at {server}")
        }
        GateMode::Replay => format!("{mode} of {}", config.gate.recording),
        _ => mode,
    };
    Judged {
        supervisor,
        judge,
        ..Judged::default()
    }
}

/// Counts a record.
pub fn count(judged: &mut Judged, record: &Record) {
    judged.questions += 1;
    judged.cost_usd += record.cost_usd;
    let count = match record.preference {
        Some(Preference::Expert) => &mut judged.expert,
        Some(Preference::Policy) => &mut judged.policy,
        Some(Preference::Abstain) => &mut judged.abstained,
        None => &mut judged.failed,
    };
    *count += 1;
    judged.similar += u64::from(record.said() == Said::Similar);
    if let Some(fault) = record.failure() {
        *judged.faults.entry(fault.into()).or_default() += 1;
    }
}
