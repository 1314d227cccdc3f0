//! A tick of the world over the cars and obstacles in it.

use shm_config::config::Config;

use super::beams::{Drive, Timed};
use super::sweep::{Bench, Cost};

/// Traffic in thousandths of the density; 60 is the paper's 0.06 cars per 10 m of lane.
pub const VALUES: [u64; 6] = [15, 30, 60, 120, 240, 480];

/// Measures a tick with its observation; the work is the mean number of bodies beside the
/// ego.
///
/// # Errors
/// If a seed has no map.
pub fn measure(value: u64, bench: &Bench) -> anyhow::Result<Option<Cost>> {
    let mut config = Config::default();
    config.world.traffic_density = value as f64 * 1e-3;
    let mut drive = Drive::new(&config)?;
    let turns = bench.turns(|| drive.turn_us(bench, Timed::Tick))?;
    Ok(turns.map(|turns| Cost {
        work: drive.bodies as f64 / drive.ticks as f64,
        turns,
        late: None,
    }))
}
