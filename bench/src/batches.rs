//! What a batch loses against one world: the same ticks of the same worlds, once world by
//! world and once as a batch, in turns on one thread.
//!
//! Both drive the same seeds with the same recorded actions, so they differ in one thing:
//! world by world, a world is in the first cache when its next tick begins. Ticks of both
//! alternate every few milliseconds, so that other programs on the machine disturb both.

use std::num::NonZeroUsize;

use serde::Serialize;
use shm_config::message::Observation;
use sim::{AfterEnd, Batch, BatchConfig, World, WorldConfig};
use stack::lane_keeper::keep_lane;
use vehicle::Action;

use crate::gauges::Gauges;
use lab::report::table;
use lab::statistics::{Estimate, quantile};

/// Worlds of the compared batches.
const SIZES: [usize; 4] = [16, 64, 256, 1000];
/// Ticks of a comparison from the beginning of the episodes, without resets: by then most
/// worlds have traffic around the ego.
const TICKS: usize = 300;
/// Ticks that a world makes in a row where it is alone.
const PORTION: usize = 10;

/// One size of batch beside the same worlds alone.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Worlds of the batch.
    pub worlds: usize,
    /// Ticks of one ego by processor time, median of the turns.
    pub alone_per_s_per_core: f64,
    /// The same in the batch.
    pub batch_per_s_per_core: f64,
    /// Speed of the batch over that of the worlds alone: mean of the turns.
    pub ratio: Estimate,
    /// Turns.
    pub turns: usize,
}

/// A world that is stepped alone.
struct Alone {
    world: World,
    observation: Box<Observation>,
}

/// Compares every size for some seconds.
///
/// # Errors
/// If the configuration is out of range, a seed has no map, or the two ways drive
/// differently.
pub fn measure(
    config: &WorldConfig,
    (first_seed, seconds): (u64, f64),
    gauges: Gauges,
) -> anyhow::Result<Vec<Row>> {
    let most = SIZES.into_iter().max().unwrap_or_default();
    let actions = record(config, first_seed, most)?;
    let rows = SIZES.map(|worlds| {
        let begun = gauges.now();
        let mut turns = Vec::new();
        while turns.is_empty() || (gauges.now().since_ns(begun) as f64) < seconds * 1e9 {
            compare(config, (first_seed, worlds), &actions, &mut turns, gauges)?;
        }
        let ratios: Vec<f64> = turns
            .iter()
            .map(|[alone_s, batch_s]| alone_s / batch_s)
            .collect();
        let ticks = (worlds * PORTION) as f64;
        let rate = |way: usize| {
            let core_s: Vec<f64> = turns.iter().map(|turn| turn[way]).collect();
            ticks / quantile(&core_s, 0.5)
        };
        Ok(Row {
            worlds,
            alone_per_s_per_core: rate(0),
            batch_per_s_per_core: rate(1),
            ratio: Estimate::of_mean(&ratios),
            turns: turns.len(),
        })
    });
    rows.into_iter().collect()
}

/// The lane keeper's actions of the first ticks of each world: `[tick][world]`.
fn record(
    config: &WorldConfig,
    first_seed: u64,
    worlds: usize,
) -> anyhow::Result<Vec<Vec<Action>>> {
    let mut world = World::new(config.clone())?;
    let mut observation = Box::<Observation>::default();
    let mut actions = vec![vec![Action::BRAKE; worlds]; TICKS];
    for k in 0..worlds {
        world.reset(first_seed + k as u64)?;
        for tick in &mut actions {
            world.observe(&mut observation);
            tick[k] = keep_lane(&observation);
            world.step(tick[k]);
        }
    }
    Ok(actions)
}

/// Drives all ticks both ways; adds the processor time of each turn, s: alone, batch.
fn compare(
    config: &WorldConfig,
    (first_seed, worlds): (u64, usize),
    actions: &[Vec<Action>],
    turns: &mut Vec<[f64; 2]>,
    gauges: Gauges,
) -> anyhow::Result<()> {
    let first = World::new(config.clone())?;
    let mut alone = Vec::with_capacity(worlds);
    for k in 0..worlds {
        let mut world = first.clone();
        world.reset(first_seed + k as u64)?;
        let observation = Box::default();
        alone.push(Alone { world, observation });
    }
    let settings = BatchConfig {
        worlds: NonZeroUsize::new(worlds).unwrap_or(NonZeroUsize::MIN),
        threads: NonZeroUsize::MIN,
        after_end: AfterEnd::Stay,
    };
    let mut batch = Batch::new(config, settings, first_seed)?;
    for actions in actions.chunks_exact(PORTION) {
        let begun = gauges.core();
        for (k, Alone { world, observation }) in alone.iter_mut().enumerate() {
            for tick in actions {
                world.step(tick[k]);
                world.observe(observation);
            }
        }
        let between = gauges.core();
        for tick in actions {
            batch.step(&tick[..worlds])?;
        }
        let ended = gauges.core();
        turns.push([between - begun, ended - between].map(|time| time.as_secs_f64()));
    }
    let mut differs = None;
    batch.visit(|k, report| {
        if *report.observation != *alone[k].observation {
            differs = differs.or(Some(first_seed + k as u64));
        }
    });
    match differs {
        None => Ok(()),
        Some(seed) => anyhow::bail!("seed {seed} drives differently alone and in a batch"),
    }
}

/// The rows as a table.
pub fn printed(rows: &[Row]) -> String {
    let mut table = table(&[
        "worlds, one thread, no resets",
        "alone, per core-second",
        "batch",
        "ratio batch/single",
        "95 % interval",
    ]);
    for row in rows {
        let Estimate { mean, low, high } = row.ratio;
        table.add_row([
            row.worlds.to_string(),
            format!("{:.0}", row.alone_per_s_per_core),
            format!("{:.0}", row.batch_per_s_per_core),
            format!("{mean:.2}"),
            format!("{low:.2} to {high:.2}"),
        ]);
    }
    table.to_string()
}
