//! The ports of the render thread. Those of a tick are `robot::ports`.

use shm_config::message::{Foresight, Frame, FrameRequest};
use shm_config::services::{FORESIGHT, FRAME, FRAME_REQUEST};

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
