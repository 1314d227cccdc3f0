//! Drives many episodes and classifies their outcomes by the paper's metric and by the
//! strict one.

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc;

use anyhow::Context;
use hdrhistogram::Histogram;
use shm_config::config::{Config, Simulator};
use shm_config::message::{Episode, Outcome};
use sim::{World, WorldConfig};

use crate::outside;
use crate::stop::Stop;
use stack::Clock;
use stack::driver::{DriverKind, EpisodeDriver, planning_histogram};
use stack::episode::drive;

/// The episodes to drive, and their driver.
#[derive(Clone, Debug)]
pub struct Task {
    /// The driver.
    pub driver: DriverKind,
    /// World.
    pub world: Simulator,
    /// Seed of the first episode; each following episode adds one.
    pub first_seed: u64,
    /// Number of episodes.
    pub episodes: u64,
    /// Number of threads; the results do not depend on it.
    pub threads: NonZeroUsize,
}

/// Results of the episodes.
pub struct Drives {
    /// The episodes, sorted by seed.
    pub episodes: Vec<Episode>,
    /// Time of each plan, us.
    pub planning_us: Histogram<u64>,
}

/// Drives all episodes in the task's world; calls `done` with each finished episode, in
/// any order.
///
/// # Errors
/// If the configuration is out of range, a seed has no map, or
/// [`outside::evaluate`] fails.
pub fn evaluate(
    task: &Task,
    config: &Config,
    clock: Clock,
    done: impl FnMut(&Episode),
) -> anyhow::Result<Drives> {
    match task.world {
        Simulator::BuiltIn => evaluate_inside(task, config, (clock, &Stop::default()), done),
        _ => outside::evaluate(task, config, clock, done),
    }
}

/// The same in the built-in world, whichever world the task names. After a stop request
/// no further episode begins, so that fewer episodes are returned.
///
/// # Errors
/// If the configuration is out of range or a seed has no map.
pub fn evaluate_inside(
    task: &Task,
    config: &Config,
    (clock, stop): (Clock, &Stop),
    mut done: impl FnMut(&Episode),
) -> anyhow::Result<Drives> {
    let next = AtomicU64::new(0);
    let (send, ended) = mpsc::channel();
    let threads = task.threads.get().min(task.episodes.max(1) as usize);
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads)
            .map(|_| {
                let (next, send) = (&next, send.clone());
                scope.spawn(move || work((task, config), (clock, stop), next, &send))
            })
            .collect();
        drop(send);
        let mut episodes: Vec<Episode> = Vec::new();
        for episode in ended {
            done(&episode);
            episodes.push(episode);
        }
        let mut planning_us = planning_histogram();
        for worker in workers {
            let times = match worker.join() {
                Ok(worked) => worked?,
                Err(panic) => std::panic::resume_unwind(panic),
            };
            planning_us.add(times).context("planning times")?;
        }
        episodes.sort_by_key(|episode| episode.seed);
        Ok(Drives {
            episodes,
            planning_us,
        })
    })
}

/// Drives episodes until none is left.
fn work(
    (task, config): (&Task, &Config),
    (clock, stop): (Clock, &Stop),
    next: &AtomicU64,
    send: &mpsc::Sender<Episode>,
) -> anyhow::Result<Histogram<u64>> {
    let mut world = World::new(WorldConfig::from(config))?;
    let mut driver = EpisodeDriver::new(task.driver, config, clock)?;
    let period_ns = config.run.period_ns();
    loop {
        let index = next.fetch_add(1, Ordering::Relaxed);
        if index >= task.episodes || stop.is_asked() {
            return Ok(driver.planning_us().clone());
        }
        let seed = task.first_seed.wrapping_add(index);
        let driven = drive(&mut world, &mut driver, (seed, period_ns), |_| {});
        let episode = driven.with_context(|| format!("seed {seed}"))?;
        if send.send(episode).is_err() {
            return Ok(driver.planning_us().clone());
        }
    }
}

/// The reason why an episode is not a strict success.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Cause {
    /// The car left the road.
    OutOfRoad,
    /// The episode reached its maximum number of steps.
    MaxStep,
    /// A stop was requested.
    Stopped,
    /// The car arrived, but touched a vehicle on the way.
    TouchedVehicle,
    /// The car arrived, but touched an object on the way.
    TouchedObject,
}

impl Cause {
    /// All causes, the paper's failures first.
    pub const ALL: [Cause; 5] = [
        Cause::OutOfRoad,
        Cause::MaxStep,
        Cause::Stopped,
        Cause::TouchedVehicle,
        Cause::TouchedObject,
    ];

    /// The cause of an episode's failure; `None` for a strict success. If the car touched
    /// both a vehicle and an object, the vehicle counts.
    pub fn of(episode: &Episode) -> Option<Cause> {
        match episode.outcome() {
            Outcome::OutOfRoad => Some(Cause::OutOfRoad),
            Outcome::MaxStep => Some(Cause::MaxStep),
            Outcome::Stopped | Outcome::Driving => Some(Cause::Stopped),
            Outcome::Arrived if episode.vehicle_contacts > 0 => Some(Cause::TouchedVehicle),
            Outcome::Arrived if episode.object_contacts > 0 => Some(Cause::TouchedObject),
            Outcome::Arrived => None,
        }
    }

    /// Description in the table.
    pub fn words(self) -> &'static str {
        match self {
            Cause::OutOfRoad => "out of road",
            Cause::MaxStep => "max step",
            Cause::Stopped => "stopped",
            Cause::TouchedVehicle => "arrived, touched a vehicle",
            Cause::TouchedObject => "arrived, touched an object",
        }
    }
}
