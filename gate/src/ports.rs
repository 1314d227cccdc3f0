//! The ports of the gate process.

use shm_config::message::{Advice, Foresight, Frame, FrameRequest, Step};
use shm_config::services::{ADVICE, FORESIGHT, FRAME, FRAME_REQUEST, STEP};

shm_config::ports! {
    /// What the gate's loop reads and publishes.
    pub struct Ports of Gate with bell {
        /// The newest record of a tick.
        steps: newest STEP: Step,
        /// The gate's advice.
        advices: write ADVICE: Advice,
    }
}

shm_config::ports! {
    /// What the thread that asks a model reads and publishes.
    pub struct PicturePorts of Gate {
        /// Requests for pictures.
        requests: write FRAME_REQUEST: FrameRequest,
        /// The pictures.
        frames: newest FRAME: Frame,
        /// What would follow if either proposal were held.
        foresights: newest FORESIGHT: Foresight,
    }
}
