//! A batch over its worlds: processor time of a step, and memory.

use std::num::NonZeroUsize;

use anyhow::Context;
use shm_config::config::Config;
use sim::{AfterEnd, Batch, BatchConfig, WorldConfig};
use stack::lane_keeper::keep_lane;
use vehicle::Action;

use super::sweep::{Bench, Cost};

/// Worlds of a batch.
pub const VALUES: [u64; 6] = [1, 4, 16, 64, 256, 1024];
/// Seed of the first world.
const FIRST_SEED: u64 = 1000;
/// Ticks of a turn: until then traffic has come near.
const TICKS: usize = 30;

fn batch(value: u64) -> anyhow::Result<Batch> {
    let worlds = NonZeroUsize::new(usize::try_from(value)?).context("worlds")?;
    let settings = BatchConfig {
        worlds,
        // All work is on the measured thread.
        threads: NonZeroUsize::MIN,
        after_end: AfterEnd::Restart { stride: value },
    };
    let config = WorldConfig::from(&Config::default());
    Ok(Batch::new(&config, settings, FIRST_SEED)?)
}

/// Measures a step of all worlds, with resets, without the driver.
///
/// # Errors
/// If a seed has no map.
pub fn steps(value: u64, bench: &Bench) -> anyhow::Result<Option<Cost>> {
    let mut batch = batch(value)?;
    let mut actions = vec![Action::default(); batch.len()];
    let turns = bench.turns(|| {
        let (mut core_s, mut stepped) = (0.0, Ok(()));
        for _ in 0..TICKS {
            batch.visit(|k, report| actions[k] = keep_lane(report.observation));
            core_s += bench.core_s(|| stepped = batch.step(&actions));
            std::mem::replace(&mut stepped, Ok(()))?;
        }
        Ok(core_s * 1e6 / TICKS as f64)
    })?;
    Ok(turns.map(|turns| Cost {
        work: value as f64,
        turns,
        late: None,
    }))
}

/// Measures the heap that a batch holds, once: it is the same each time.
///
/// # Errors
/// If a seed has no map.
pub fn memory(value: u64, bench: &Bench) -> anyhow::Result<Option<Cost>> {
    if bench.stop.is_asked() {
        return Ok(None);
    }
    let before = bench.gauges.bytes_held();
    let batch = batch(value)?;
    let held = bench.gauges.bytes_held().saturating_sub(before);
    drop(batch);
    Ok(Some(Cost {
        work: value as f64,
        turns: vec![held as f64 * 1e-3],
        late: None,
    }))
}
