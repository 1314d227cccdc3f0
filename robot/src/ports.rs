//! The ports of a world process.

use shm_config::message::{Command, Episode, Observation, Progress};
use shm_config::services::{COMMAND, EPISODE, OBSERVATION, PROGRESS};

shm_config::ports! {
    /// What a tick of the world reads and publishes.
    pub struct Ports of World {
        /// The command for the car.
        commands: read COMMAND: Command,
        /// The observation.
        observations: write OBSERVATION: Observation,
        /// The progress of the episode.
        progress: write PROGRESS: Progress,
        /// The result of an episode.
        episodes: write EPISODE: Episode,
    }
}
