//! An evaluation over its episodes.

use shm_config::config::Config;
use sim::{World, WorldConfig};
use stack::driver::{DriverKind, EpisodeDriver};
use stack::episode::drive;

use super::sweep::{Bench, Cost};

/// Episodes of an evaluation.
pub const VALUES: [u64; 7] = [1, 2, 4, 8, 16, 32, 64];
/// Seed of the first episode, as in `./vlaps eval`.
const FIRST_SEED: u64 = 1000;

/// Measures an evaluation of the lane keeper on one thread, resets included.
///
/// # Errors
/// If a seed has no map.
pub fn measure(value: u64, bench: &Bench) -> anyhow::Result<Option<Cost>> {
    let config = Config::default();
    let period_ns = config.run.period_ns();
    let mut world = World::new(WorldConfig::from(&config))?;
    let mut driver = EpisodeDriver::new(DriverKind::Lane, &config, bench.gauges.clock())?;
    let turns = bench.turns(|| {
        let mut driven = Ok(());
        let core_s = bench.core_s(|| {
            driven = (FIRST_SEED..FIRST_SEED + value).try_for_each(|seed| {
                drive(&mut world, &mut driver, (seed, period_ns), |_| {}).map(drop)
            });
        });
        driven?;
        Ok(core_s * 1e3)
    })?;
    Ok(turns.map(|turns| Cost {
        work: value as f64,
        turns,
        late: None,
    }))
}
