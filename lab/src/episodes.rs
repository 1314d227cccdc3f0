//! Drives many episodes and classifies their outcomes by the paper's metric and by the
//! strict one.

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;

use anyhow::Context;
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
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

impl Task {
    /// The seeds of its episodes.
    pub fn seeds(&self) -> impl Iterator<Item = u64> {
        (0..self.episodes).map(|index| self.first_seed.wrapping_add(index))
    }
}

/// A driven episode.
pub struct DrivenEpisode {
    /// How it ended.
    pub episode: Episode,
    /// Time of each plan, us; `None` for drivers that do not plan.
    pub planning_us: Option<Histogram<u64>>,
}

/// Results of the episodes.
pub struct Drives {
    /// The episodes, sorted by seed.
    pub episodes: Vec<Episode>,
    /// Time of each plan, us.
    pub planning_us: Histogram<u64>,
}

impl Drives {
    /// Without an episode.
    pub fn none() -> Drives {
        Drives {
            episodes: Vec::new(),
            planning_us: planning_histogram(),
        }
    }

    /// Adds an episode.
    ///
    /// # Errors
    /// If its planning times do not fit into the histogram.
    pub fn add(&mut self, driven: DrivenEpisode) -> anyhow::Result<()> {
        self.episodes.push(driven.episode);
        if let Some(planning_us) = driven.planning_us {
            let added = self.planning_us.add(planning_us);
            added.context("planning times")?;
        }
        Ok(())
    }
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
    mut done: impl FnMut(&Episode),
) -> anyhow::Result<Drives> {
    match task.world {
        Simulator::BuiltIn => evaluate_inside(task, config, (clock, &Stop::default()), done),
        _ => {
            let mut drives = Drives::none();
            outside::evaluate(task, config, clock, |driven| {
                done(&driven.episode);
                drives.add(driven)
            })?;
            drives.episodes.sort_by_key(|episode| episode.seed);
            Ok(drives)
        }
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
    watch: (Clock, &Stop),
    mut done: impl FnMut(&Episode),
) -> anyhow::Result<Drives> {
    let seeds: Vec<u64> = task.seeds().collect();
    let mut drives = Drives::none();
    evaluate_seeds((task, &seeds), config, watch, |driven| {
        done(&driven.episode);
        drives.add(driven)
    })?;
    drives.episodes.sort_by_key(|episode| episode.seed);
    Ok(drives)
}

/// Drives the episodes of these seeds in the built-in world, and hands over each when it is
/// finished, in any order.
///
/// # Errors
/// As [`evaluate_inside`], and the first error of `done`.
pub fn evaluate_seeds(
    (task, seeds): (&Task, &[u64]),
    config: &Config,
    (clock, stop): (Clock, &Stop),
    mut done: impl FnMut(DrivenEpisode) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let next = AtomicUsize::new(0);
    let (send, ended) = mpsc::channel();
    let threads = task.threads.get().min(seeds.len().max(1));
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads)
            .map(|_| {
                let (next, send) = (&next, send.clone());
                let given = (task.driver, seeds);
                scope.spawn(move || work(given, config, (clock, stop), (next, &send)))
            })
            .collect();
        drop(send);
        for driven in ended {
            // Without a receiver the workers end.
            done(driven)?;
        }
        for worker in workers {
            match worker.join() {
                Ok(worked) => worked?,
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        Ok(())
    })
}

/// Drives episodes until none is left.
fn work(
    (driver, seeds): (DriverKind, &[u64]),
    config: &Config,
    (clock, stop): (Clock, &Stop),
    (next, send): (&AtomicUsize, &mpsc::Sender<DrivenEpisode>),
) -> anyhow::Result<()> {
    let mut world = World::new(WorldConfig::from(config))?;
    let mut driver = EpisodeDriver::new(driver, config, clock)?;
    let period_ns = config.run.period_ns();
    loop {
        let index = next.fetch_add(1, Ordering::Relaxed);
        let Some(&seed) = seeds.get(index).filter(|_| !stop.is_asked()) else {
            return Ok(());
        };
        let driven = drive(&mut world, &mut driver, (seed, period_ns), |_| {});
        let driven = DrivenEpisode {
            episode: driven.with_context(|| format!("seed {seed}"))?,
            planning_us: driver.take_planning_us(),
        };
        if send.send(driven).is_err() {
            return Ok(());
        }
    }
}

/// The reason why an episode is not a strict success.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(into = "&'static str", try_from = "String")]
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

    /// Whether the car arrived all the same.
    pub fn arrived(self) -> bool {
        matches!(self, Cause::TouchedVehicle | Cause::TouchedObject)
    }

    /// Description in tables and files.
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

impl From<Cause> for &'static str {
    fn from(cause: Cause) -> &'static str {
        cause.words()
    }
}

impl TryFrom<String> for Cause {
    type Error = String;

    fn try_from(words: String) -> Result<Cause, String> {
        let found = Cause::ALL.into_iter().find(|cause| cause.words() == words);
        found.ok_or_else(|| format!("unknown cause of a failure: {words:?}"))
    }
}
