//! The ports of the world process.

use shm_config::message::{
    Command, Episode, Foresight, Frame, FrameRequest, Observation, Progress,
};
use shm_config::services::{
    COMMAND, EPISODE, FORESIGHT, FRAME, FRAME_REQUEST, OBSERVATION, PROGRESS,
};

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

shm_config::ports! {
    /// Requests for pictures.
    pub struct RequestPorts of World {
        /// Requests of the gate and of tools.
        requests: read FRAME_REQUEST: FrameRequest,
    }
}

shm_config::ports! {
    /// The answers to these requests.
    pub struct AnswerPorts of World {
        /// Pictures.
        frames: write FRAME: Frame,
        /// What would follow if either proposal were held.
        foresights: write FORESIGHT: Foresight,
    }
}
