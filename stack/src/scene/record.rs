//! Scenes from real episodes of the built-in world.

use anyhow::Context;
use shm_config::config::Config;
use shm_config::message::{Observation, Plan, PlanOutcome};
use sim::{World, WorldConfig};

use super::{Origin, Scene};
use crate::Clock;
use crate::driver::{DriverKind, EpisodeDriver};
use crate::episode::{Tick, drive};

/// One scene in this many is taken where no path to the goal was found, if
/// there are that many.
const HARD_SHARE: usize = 4;
/// A car that is slower than this stands, m/s.
const STANDS_MPS: f64 = 0.2;

/// Which scenes to record.
#[derive(Clone, Copy, Debug)]
pub struct Recording {
    /// Seed of the first episode; each further one adds one.
    pub first_seed: u64,
    /// How many episodes.
    pub episodes: u64,
    /// How many scenes.
    pub scenes: usize,
}

/// A tick that may become a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place {
    seed: u64,
    tick: u64,
    outcome: PlanOutcome,
}

/// Drives the episodes with the expert and picks scenes: a quarter of those
/// ticks at which the plan was partial or blocked, as far as there are, and the
/// rest of all others, both evenly in the order of driving. While the car
/// stands, only ticks count at which the outcome is another than before: the
/// rest would be the same scene again.
///
/// The episodes are driven twice, so that only the picked ones are held.
///
/// # Errors
/// When the configuration is out of range or a seed has no map.
pub fn record(
    recording: Recording,
    config: &Config,
    clock: Clock,
    mut done: impl FnMut(),
) -> anyhow::Result<Vec<Scene>> {
    let mut places = Vec::new();
    let mut last = None;
    over_episodes(recording, config, clock, &mut done, |seed, tick, plan| {
        let Observation { header, ego, .. } = tick.observation;
        let is_new = last.replace(plan.outcome()) != Some(plan.outcome());
        if header.tick == 0 || is_new || ego.speed_mps.abs() > STANDS_MPS {
            places.push(Place {
                seed,
                tick: header.tick,
                outcome: plan.outcome(),
            });
        }
    })?;
    let mut picked = pick(&places, recording.scenes).into_iter().peekable();
    let mut scenes = Vec::new();
    let mut before: Option<Box<Observation>> = None;
    over_episodes(recording, config, clock, &mut done, |seed, tick, plan| {
        let now = Place {
            seed,
            tick: tick.observation.header.tick,
            outcome: plan.outcome(),
        };
        let observation = Box::new(*tick.observation);
        if picked.next_if_eq(&now).is_some() {
            scenes.push(Scene {
                origin: Origin {
                    seed,
                    outcome: now.outcome,
                },
                observation: observation.clone(),
                before: before.take().filter(|_| now.tick > 0),
            });
        }
        before = Some(observation);
    })?;
    Ok(scenes)
}

fn over_episodes(
    recording: Recording,
    config: &Config,
    clock: Clock,
    done: &mut impl FnMut(),
    mut watch: impl FnMut(u64, &Tick, &Plan),
) -> anyhow::Result<()> {
    let mut world = World::new(WorldConfig::from(config))?;
    let mut driver = EpisodeDriver::new(DriverKind::Expert, config, clock)?;
    let period_ns = config.run.period_ns();
    for index in 0..recording.episodes {
        let seed = recording.first_seed.wrapping_add(index);
        drive(&mut world, &mut driver, (seed, period_ns), |tick| {
            if let Some(plan) = tick.plan {
                watch(seed, tick, plan);
            }
        })
        .with_context(|| format!("seed {seed}"))?;
        done();
    }
    Ok(())
}

/// Picks this many places, in their order.
fn pick(places: &[Place], count: usize) -> Vec<Place> {
    let indices = |hard: bool| -> Vec<usize> {
        let is_hard = |place: &Place| place.outcome != PlanOutcome::Reached;
        (0..places.len())
            .filter(|&index| is_hard(&places[index]) == hard)
            .collect()
    };
    let mut picked = evenly(&indices(true), count / HARD_SHARE);
    picked.extend(evenly(&indices(false), count - picked.len()));
    picked.sort_unstable();
    picked.into_iter().map(|index| places[index]).collect()
}

/// Of these at most that many, evenly, the first one among them.
fn evenly(of: &[usize], count: usize) -> Vec<usize> {
    let count = count.min(of.len());
    (0..count).map(|k| of[k * of.len() / count]).collect()
}
