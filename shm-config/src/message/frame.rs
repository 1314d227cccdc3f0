use vehicle::Action;

use super::{
    Camera, Header, Message, Proposal, Refusal, View, fits, header_accessors, known, within,
};

/// Bytes of the largest frame: 960 x 720 pixels of three bytes.
pub const FRAME_BYTES_MAX: usize = 960 * 720 * 3;
/// Least and greatest width and height of a requested frame, pixels: in smaller frames
/// a car is a dot.
pub const FRAME_SIDES_PX: core::ops::RangeInclusive<u32> = 64..=2048;

crate::word_list! {
    /// How a pixel is stored.
    pub enum PixelFormat {
        /// Red, green, blue; a byte each.
        Rgb8 = 0 "rgb8",
    }
}

crate::message! {
    /// A picture of the scene with the camera that took it.
    pub struct Frame: 2073792 bytes, nested [Header, Camera] {
        /// The observation's tick.
        pub header: Header,
        /// The camera.
        pub camera: Camera,
        /// Pixels across.
        pub width: u32,
        /// Pixels down.
        pub height: u32,
        /// A [`PixelFormat`].
        pub format: u32,
        /// Not used.
        pub reserved: u32,
        /// Rows from the top, no padding between them.
        pub pixels: [u8; 2073600],
        /// Not used; keeps the size a multiple of eight.
        pub end: u64,
    }
}

const _: () = assert!(FRAME_BYTES_MAX == 2_073_600, "as the message declares");

crate::message! {
    /// A request for a picture. A world that still knows the tick answers it; without
    /// an answer the requester's own time limit ends its wait.
    #[derive(Default)]
    pub struct FrameRequest: 96 bytes, nested [Header, Proposal] {
        /// Tick, episode and instant of the observation to be shown. Where a tick has
        /// several instants, 0 ns requests the first.
        pub header: Header,
        /// The proposals of the question, the expert's first, for [`Foresight`]; if one
        /// is absent, only the picture is requested.
        pub proposals: [Proposal; 2],
        /// A [`View`].
        pub view: u32,
        /// Pixels across.
        pub width: u32,
        /// Pixels down.
        pub height: u32,
        /// Not used.
        pub reserved: u32,
    }
}

crate::message! {
    /// The result of holding one action until the horizon or the end of the episode.
    #[derive(Default)]
    pub struct Outlook: 24 bytes {
        /// Time until the end of the first tick in which a vehicle or an object is
        /// touched, s; the horizon when none is.
        pub contact_s: f64,
        /// Time until the car is out of the road, s; the horizon when it stays.
        /// That ends the episode: nothing is touched afterwards.
        pub out_s: f64,
        /// Share of the route gained, [-1, 1].
        pub completion: f64,
    }
}

crate::message! {
    /// What would happen if the car held each of two proposals, computed by a simulator
    /// that tries both. Ground truth for the record of a judge alone: no robot has it,
    /// so no decision may read it.
    #[derive(Default)]
    pub struct Foresight: 88 bytes, nested [Header, Outlook] {
        /// Tick and episode of the question.
        pub header: Header,
        /// How long each proposal is held, s.
        pub horizon_s: f64,
        /// The results, the expert's first.
        pub outlooks: [Outlook; 2],
    }
}

impl Message for Frame {
    header_accessors!();

    /// Without the pixels that it does not have.
    fn used_bytes(&self) -> usize {
        core::mem::offset_of!(Self, pixels) + self.rgb().len()
    }

    fn check(&self) -> Result<(), Refusal> {
        self.camera.check()?;
        known("format", self.format, PixelFormat::from_code)?;
        let bytes = Self::bytes([self.width, self.height]);
        fits("width * height * 3", bytes, FRAME_BYTES_MAX)
    }
}

impl Frame {
    /// Bytes of the pixels of a frame of this width and height. A size that is not checked
    /// may have more than a `u64` counts; the greatest number is then given.
    pub fn bytes([width, height]: [u32; 2]) -> u64 {
        (u64::from(width) * u64::from(height)).saturating_mul(3)
    }

    /// The pixels in use, row by row from the top, three bytes each.
    pub fn rgb(&self) -> &[u8] {
        let count = Self::bytes([self.width, self.height]).min(FRAME_BYTES_MAX as u64);
        &self.pixels[..count as usize]
    }
}

impl FrameRequest {
    /// The view; an unknown code is read as the view from above.
    pub fn view(&self) -> View {
        View::from_code(self.view).unwrap_or(View::TopDown)
    }

    /// Width and height, pixels.
    pub fn size_px(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Both actions, the expert's first; `None` where one is absent.
    pub fn actions(&self) -> Option<[Action; 2]> {
        Some([self.proposals[0].action()?, self.proposals[1].action()?])
    }
}

impl Message for FrameRequest {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        self.proposals[0].check("proposals[0]")?;
        self.proposals[1].check("proposals[1]")?;
        known("view", self.view, View::from_code)?;
        let sides = f64::from(*FRAME_SIDES_PX.start())..=f64::from(*FRAME_SIDES_PX.end());
        within("width", f64::from(self.width), sides.clone())?;
        within("height", f64::from(self.height), sides)?;
        let bytes = Frame::bytes(self.size_px());
        fits("width * height * 3", bytes, FRAME_BYTES_MAX)
    }
}

impl Message for Foresight {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        within("horizon_s", self.horizon_s, 0.0..=60.0)?;
        for outlook in &self.outlooks {
            within("contact_s", outlook.contact_s, 0.0..=self.horizon_s)?;
            within("out_s", outlook.out_s, 0.0..=self.horizon_s)?;
            within("completion", outlook.completion, -1.0..=1.0)?;
        }
        Ok(())
    }
}
