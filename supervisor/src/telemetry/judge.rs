//! The judge's record of a run, as the gate process has written it.

use std::path::Path;

use shm_config::config::Config;
use shm_config::file::read_ours;
use shm_config::judged::{Judged, SUMMARY};
use shm_config::message::Reason;

use crate::telemetry::tally::Tally;

/// Longest file that is read, bytes.
const BYTES_MAX: u64 = 1 << 16;

/// The record of the run whose supervisor has this process id; `None` without a gate
/// process or a record.
pub fn read(config: &Config, supervisor: u32) -> Option<Judged> {
    if !config.gate.has_process() {
        return None;
    }
    let path = Path::new(&config.run.folder).join(SUMMARY);
    let judged: Judged = serde_json::from_slice(&read_ours(&path, BYTES_MAX).ok()?).ok()?;
    (judged.supervisor == supervisor).then_some(judged)
}

/// Why the model was not asked any question yet; `None` where it was asked, where the gate
/// asks no model, and before the first step.
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

/// The trouble with the judge that the user should know of; empty for none. With a learner
/// a missing policy is none: the learner will publish one.
pub fn trouble(config: &Config, tally: &Tally) -> String {
    let judged = read(config, std::process::id());
    let is_unloaded = matches!(tally.steps.newest, Some((_, Reason::Unloaded)));
    match unasked(config, tally, judged.as_ref()) {
        Some(reason) if is_unloaded && !config.learner.enabled => reason.into(),
        _ => judged.map(|judged| judged.trouble).unwrap_or_default(),
    }
}
