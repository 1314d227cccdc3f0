//! An observation over the beams of its scanner.

use shm_config::config::Config;
use shm_config::message::Observation;
use sim::{World, WorldConfig};
use stack::lane_keeper::keep_lane;

use super::sweep::{Bench, Cost};

/// Beams; 240 is the paper's number.
pub const VALUES: [u64; 8] = [15, 30, 60, 120, 240, 480, 960, 1920];
/// Seed of the first episode, and number of seeds that are used again.
const FIRST_SEED: u64 = 1000;
const SEEDS: u64 = 100;
/// Ticks of a turn.
const TICKS: u64 = 500;
/// Times that each tick's work is repeated where it changes nothing, so that reading the
/// processor's time weighs little.
const REPEATS: u32 = 16;

/// Measures an observation.
///
/// # Errors
/// If a seed has no map.
pub fn measure(value: u64, bench: &Bench) -> anyhow::Result<Option<Cost>> {
    let mut config = Config::default();
    config.scanner.beams = u32::try_from(value)?;
    let mut drive = Drive::new(&config)?;
    let turns = bench.turns(|| drive.turn_us(bench, Timed::Observation))?;
    Ok(turns.map(|turns| Cost {
        work: value as f64,
        turns,
        late: None,
    }))
}

/// What is measured of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Timed {
    /// The step of the world with its observation.
    Tick,
    /// The observation alone.
    Observation,
}

/// Episodes one after the other, driven by the lane keeper.
pub struct Drive {
    world: World,
    observation: Box<Observation>,
    episodes: u64,
    /// Bodies beside the ego, added up over all ticks.
    pub bodies: u64,
    /// Ticks so far.
    pub ticks: u64,
}

impl Drive {
    /// At the first episode.
    ///
    /// # Errors
    /// If the seed has no map.
    pub fn new(config: &Config) -> anyhow::Result<Drive> {
        let mut world = World::new(WorldConfig::from(config))?;
        world.reset(FIRST_SEED)?;
        let mut observation = Box::<Observation>::default();
        world.observe(&mut observation);
        Ok(Drive {
            world,
            observation,
            episodes: 1,
            bodies: 0,
            ticks: 0,
        })
    }

    /// Processor time of a tick or of its observation, us: mean of a turn. Resets, the
    /// driver and the count of bodies are left out.
    ///
    /// # Errors
    /// If a seed has no map.
    pub fn turn_us(&mut self, bench: &Bench, timed: Timed) -> anyhow::Result<f64> {
        let mut core_s = 0.0;
        for _ in 0..TICKS {
            if self.world.last_step().has_ended() {
                self.world.reset(FIRST_SEED + self.episodes % SEEDS)?;
                self.episodes += 1;
                self.world.observe(&mut self.observation);
            }
            let action = keep_lane(&self.observation);
            let (world, observation) = (&mut self.world, &mut self.observation);
            core_s += match timed {
                Timed::Tick => bench.core_s(|| {
                    world.step(action);
                    world.observe(observation);
                }),
                Timed::Observation => {
                    world.step(action);
                    let repeated_s =
                        bench.core_s(|| (0..REPEATS).for_each(|_| world.observe(observation)));
                    repeated_s / f64::from(REPEATS)
                }
            };
            self.bodies += self.world.bodies().count() as u64;
            self.ticks += 1;
        }
        Ok(core_s * 1e6 / TICKS as f64)
    }
}
