//! A recording over its ticks: bytes of the file, and processor time to write it.

use std::fs;

use lab::replay::rehearsal::Rehearsal;
use lab::replay::source::InMemory;

use super::sweep::{Bench, Cost};

/// Ticks of a recorded run; at 10 Hz from 10 s to 5 minutes.
pub const VALUES: [u64; 6] = [100, 200, 400, 800, 1600, 3200];
/// Seed of the rehearsed run.
const SEED: u64 = 3;

fn run(value: u64) -> anyhow::Result<InMemory> {
    Rehearsal::troubled(SEED)?.run(usize::try_from(value)?)
}

/// Measures the size of the file, once: it is the same each time.
///
/// # Errors
/// If it cannot be written.
pub fn bytes(value: u64, bench: &Bench) -> anyhow::Result<Option<Cost>> {
    if bench.stop.is_asked() {
        return Ok(None);
    }
    let path = bench.scratch.path().join("bytes.mcap");
    run(value)?.save(&path)?;
    let bytes = fs::metadata(&path)?.len();
    fs::remove_file(&path)?;
    Ok(Some(Cost {
        work: value as f64,
        turns: vec![bytes as f64 * 1e-3],
        late: None,
    }))
}

/// Measures the writing, checksums and index included.
///
/// # Errors
/// If it cannot be written.
pub fn writing(value: u64, bench: &Bench) -> anyhow::Result<Option<Cost>> {
    let run = run(value)?;
    let path = bench.scratch.path().join("writing.mcap");
    let turns = bench.turns(|| {
        let mut saved = Ok(());
        let core_s = bench.core_s(|| saved = run.save(&path));
        saved?;
        Ok(core_s * 1e6)
    })?;
    let _ = fs::remove_file(&path);
    Ok(turns.map(|turns| Cost {
        work: value as f64,
        turns,
        late: None,
    }))
}
