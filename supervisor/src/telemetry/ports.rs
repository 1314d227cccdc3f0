//! The subscribers of all services that the supervisor reads.

use shm_config::Message;
use shm_config::message::{Episode, Health, HealthState, PolicyStatus, Progress, Step, Timing};
use shm_config::services::{
    EPISODE, EPISODE_QUEUE, HEALTH, POLICY_STATUS, PROGRESS, Process, STEP, STEP_QUEUE, TIMING,
};
use shm_config::wire::Subscriber;

use crate::telemetry::tally::Tally;

/// The most pending messages of a latest-value service: one of each publisher, the living
/// one and dead ones.
const PENDING_MAX: usize = 8;

shm_config::ports! {
    /// The subscribers of a run. Services that do not exist yet are created, so that no
    /// message of a child is missed.
    pub struct Ports of Supervisor {
        /// How each process does.
        healths: each HEALTH: Health,
        /// How punctual each process is.
        timings: each TIMING: Timing,
        /// How the episode goes.
        progress: read PROGRESS: Progress,
        /// How episodes ended.
        episodes: read EPISODE: Episode,
        /// What became of offered weights.
        policies: read POLICY_STATUS: PolicyStatus,
        /// Every tick of the controller.
        steps: read STEP: Step,
    }
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

impl Ports {
    /// Reads all new messages into the tally; returns the healths among them. Never blocks.
    pub fn drain(&mut self, tally: &mut Tally) -> Vec<Sign> {
        let mut signs = Vec::new();
        for (process, port) in &mut self.healths.0 {
            for health in pending(port, PENDING_MAX) {
                match tally.count_health(*process, &health) {
                    Some(state) => signs.push(Sign {
                        process: *process,
                        pid: health.header.producer,
                        state,
                    }),
                    None => tally.refused += 1,
                }
            }
        }
        for (process, port) in &mut self.timings.0 {
            for timing in pending(port, PENDING_MAX) {
                tally.count_timing(*process, timing);
            }
        }
        // Episodes are read before the progress, so the progress is of the same or a later
        // episode: only an episode that the world has started can have ended.
        let episodes: Vec<_> = pending(&mut self.episodes, EPISODE_QUEUE).collect();
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
