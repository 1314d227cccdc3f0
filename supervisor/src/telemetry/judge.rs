//! What a run's judge was asked and said, as the gate process has written it down.

use std::path::Path;

use shm_config::config::Config;
use shm_config::file::read_ours;
use shm_config::judged::{Judged, SUMMARY};
use shm_config::message::Reason;

use crate::telemetry::tally::Tally;

/// Longest file that is read, bytes.
const BYTES_MAX: u64 = 1 << 16;

/// Of a run whose supervisor has this process id; `None` where nobody judges, or
/// nothing is written down.
pub fn read(config: &Config, supervisor: u32) -> Option<Judged> {
    if !config.gate.has_process() {
        return None;
    }
    let path = Path::new(&config.run.folder).join(SUMMARY);
    let judged: Judged = serde_json::from_slice(&read_ours(&path, BYTES_MAX).ok()?).ok()?;
    (judged.supervisor == supervisor).then_some(judged)
}

/// Why a model that is to judge was not asked one question yet; `None` where it was,
/// where none judges, and before the first step.
pub fn unasked(config: &Config, tally: &Tally, judged: Option<&Judged>) -> Option<&'static str> {
    let was_asked = judged.is_some_and(|judged| judged.questions > 0);
    if was_asked || !config.gate.asks_model() {
        return None;
    }
    let (_, newest) = tally.steps.newest?;
    Some(match newest == Reason::Unloaded {
        true => "never asked: no policy is loaded; add --policy FILE.onnx",
        false => "never asked: no question came up",
    })
}

/// What a person should know of the judge while the set drives; empty for nothing. A
/// learner brings its policy itself.
pub fn trouble(config: &Config, tally: &Tally) -> String {
    let judged = read(config, std::process::id());
    let is_unloaded = matches!(tally.steps.newest, Some((_, Reason::Unloaded)));
    match unasked(config, tally, judged.as_ref()) {
        Some(reason) if is_unloaded && !config.learner.enabled => reason.into(),
        _ => judged.map(|judged| judged.trouble).unwrap_or_default(),
    }
}
