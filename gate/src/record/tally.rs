use shm_config::config::{Config, GateMode, PassTo};
use shm_config::judged::{Judged, NetCounts};
use shm_config::message::Preference;

use super::{NetOpinion, Record, Said, word};
use crate::judge::agree;

/// Counts at zero, for the configured judge in the run of this supervisor.
pub fn begin(config: &Config, supervisor: u32) -> Judged {
    let mode = format!("{:?}", config.gate.mode).to_lowercase();
    let judge = match config.gate.mode {
        GateMode::Distilled => {
            let slow = match config.gate.pass_to {
                PassTo::Vlm => {
                    let (model, server) = (config.vlm.model_name(), &config.vlm.server);
                    format!("{model} at {server}")
                }
                PassTo::Rules => "rules".into(),
            };
            format!("{mode}, {} before {slow}", config.gate.distilled)
        }
        _ if config.gate.asks_model() => {
            let (model, server) = (config.vlm.model_name(), &config.vlm.server);
            format!("{mode}, {model} at {server}")
        }
        GateMode::Replay => format!("{mode} of {}", config.gate.recording),
        _ => mode,
    };
    let net = config.gate.mode == GateMode::Distilled;
    Judged {
        supervisor,
        judge,
        net: net.then(NetCounts::default),
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
    if let (Some(counts), Some(net)) = (&mut judged.net, &record.net) {
        count_net(counts, net, record.preference);
    }
    if let Some(fault) = record.failure() {
        *judged.faults.entry(fault.into()).or_default() += 1;
    }
}

fn count_net(counts: &mut NetCounts, net: &NetOpinion, preference: Option<Preference>) {
    if net.passed_on.is_some() {
        counts.passed_on += 1;
        return;
    }
    counts.answered += 1;
    let slow = net.audit.as_deref().and_then(word::read).flatten();
    if let (Some(net), Some(slow)) = (preference, slow)
        && let Some(is_agreed) = agree(net, slow)
    {
        counts.audited += 1;
        counts.agreed += u64::from(is_agreed);
    }
}
