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
        /// What the car shall do.
        commands: read COMMAND: Command,
        /// What the car perceives.
        observations: write OBSERVATION: Observation,
        /// How the episode goes.
        progress: write PROGRESS: Progress,
        /// How an episode ended.
        episodes: write EPISODE: Episode,
    }
}

shm_config::ports! {
    /// Which pictures are wanted.
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
        /// What holding either proposal would lead to.
        foresights: write FORESIGHT: Foresight,
    }
}
