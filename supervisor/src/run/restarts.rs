//! The restarts of each process of a run. Only the supervisor knows them; it writes them
//! beside the run's other files, for commands that observe the run from outside.

use std::collections::BTreeMap;
use std::fs;

use shm_config::run::RunPaths;

use crate::cli::output::write_whole;
use crate::set::member::Member;

/// Its name in the run's place.
const FILE: &str = "restarts.json";
/// Longest file that is read, bytes.
const BYTES_MAX: u64 = 1 << 12;

/// Writes the number of restarts of each process. On an error `status` shows none.
pub fn write(paths: &RunPaths, members: &[Member]) {
    let counts = members
        .iter()
        .map(|member| (member.row().process.word(), member.restarts()));
    let counts: BTreeMap<_, _> = counts.collect();
    if let Ok(text) = serde_json::to_string(&counts) {
        let _ = write_whole(&paths.dir().join(FILE), &text);
    }
}

/// The number of restarts by process; empty before the first one.
pub fn read(paths: &RunPaths) -> BTreeMap<String, u32> {
    let path = paths.dir().join(FILE);
    let is_ours = fs::metadata(&path).is_ok_and(|metadata| metadata.len() <= BYTES_MAX);
    let text = is_ours.then(|| fs::read_to_string(&path).unwrap_or_default());
    text.and_then(|text| serde_json::from_str(&text).ok())
        .unwrap_or_default()
}
