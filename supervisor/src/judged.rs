//! What a run's judge was asked and said, as the gate process has written it down.

use std::fs;
use std::path::Path;

use shm_config::config::Config;
use shm_config::judged::{Judged, SUMMARY};

/// Longest file that is read, bytes.
const BYTES_MAX: u64 = 1 << 16;

/// Of a run whose supervisor has this process id; `None` where nobody judges, or
/// nothing is written down.
pub fn read(config: &Config, supervisor: u32) -> Option<Judged> {
    if !config.gate.has_process() {
        return None;
    }
    let path = Path::new(&config.run.folder).join(SUMMARY);
    if fs::metadata(&path).ok()?.len() > BYTES_MAX {
        return None;
    }
    let judged: Judged = serde_json::from_str(&fs::read_to_string(path).ok()?).ok()?;
    (judged.supervisor == supervisor).then_some(judged)
}
