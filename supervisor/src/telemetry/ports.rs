//! The subscribers of all services that the supervisor reads.

use shm_config::Message;
use shm_config::config::Config;
use shm_config::message::{Episode, Health, HealthState, PolicyStatus, Progress, Step, Timing};
use shm_config::services::{self, Process, STEP_QUEUE};
use shm_config::wire::{Subscriber, Wire, WireError};

use crate::set::table::rows;
use crate::telemetry::tally::Tally;

/// The most pending messages of a latest-value service: one of each publisher, the living
/// one and dead ones.
const PENDING_MAX: usize = 8;

/// Ports of one process.
struct Watch {
    process: Process,
    health: Subscriber<Health>,
    timing: Subscriber<Timing>,
}

/// The subscribers of a run.
pub struct Ports {
    watches: Vec<Watch>,
    progress: Subscriber<Progress>,
    episodes: Subscriber<Episode>,
    policies: Subscriber<PolicyStatus>,
    steps: Subscriber<Step>,
}

/// The health of one process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sign {
    /// The process.
    pub process: Process,
    /// Its process id.
    pub pid: u32,
    /// Its state.
    pub state: HealthState,
}

/// How much of the step queue is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// All steps, to count them.
    All,
    /// Only the newest, to see which driver drives.
    Newest,
}

impl Ports {
    /// Opens all subscribers. Services that do not exist yet are created, so that no message
    /// of a child is missed.
    ///
    /// # Errors
    /// When the layout differs from the running side's, or shared memory refuses.
    pub fn open(wire: &Wire, config: &Config, depth: Depth) -> Result<Self, WireError> {
        let mut watches = Vec::new();
        for row in rows(config) {
            let process = row.process;
            watches.push(Watch {
                process,
                health: wire.subscriber(services::health(process))?,
                timing: wire.subscriber(services::timing(process))?,
            });
        }
        Ok(Self {
            watches,
            progress: wire.subscriber(services::PROGRESS)?,
            episodes: wire.subscriber(services::EPISODE)?,
            policies: wire.subscriber(services::POLICY_STATUS)?,
            steps: match depth {
                Depth::All => wire.subscriber(services::STEP)?,
                Depth::Newest => wire.latest(services::STEP)?,
            },
        })
    }

    /// Reads all new messages into the tally; returns the healths among them. Never blocks.
    pub fn drain(&mut self, tally: &mut Tally) -> Vec<Sign> {
        let mut signs = Vec::new();
        for watch in &mut self.watches {
            for health in pending(&mut watch.health, PENDING_MAX) {
                match tally.count_health(watch.process, &health) {
                    Some(state) => signs.push(Sign {
                        process: watch.process,
                        pid: health.header.producer,
                        state,
                    }),
                    None => tally.refused += 1,
                }
            }
            for timing in pending(&mut watch.timing, PENDING_MAX) {
                tally.count_timing(watch.process, timing);
            }
        }
        // Episodes are read before the progress, so the progress is of the same or a later
        // episode: only an episode that the world has started can have ended.
        let episodes: Vec<_> = pending(&mut self.episodes, services::EPISODE_QUEUE).collect();
        for progress in pending(&mut self.progress, PENDING_MAX) {
            tally.count_progress(progress);
        }
        let begun = tally.progress.map(|progress| progress.header.episode);
        for episode in episodes {
            match begun.is_some_and(|begun| episode.header.episode <= begun) {
                true => tally.count_episode(episode),
                false => tally.refused += 1,
            }
        }
        for status in pending(&mut self.policies, PENDING_MAX) {
            tally.count_policy(status);
        }
        // Bounded by the queue: a producer that is faster than this loop cannot keep it
        // here.
        for step in pending(&mut self.steps, STEP_QUEUE) {
            tally.count_step(&step);
        }
        signs
    }
}

fn pending<M: Message>(port: &mut Subscriber<M>, most: usize) -> impl Iterator<Item = M> {
    port.update_connections();
    std::iter::from_fn(|| port.receive()).take(most)
}
