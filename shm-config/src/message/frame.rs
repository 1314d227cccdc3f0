use super::{Header, Message, Refusal, fits, header_accessors, known, within};

/// Bytes of the largest frame: 960 x 720 pixels of three bytes.
pub const FRAME_BYTES_MAX: usize = 960 * 720 * 3;

crate::word_list! {
    /// From where a frame is seen.
    pub enum View {
        /// From the driver's seat.
        Ego = 0 "ego",
        /// From above, heading up.
        TopDown = 1 "top_down",
    }
}

crate::word_list! {
    /// How a pixel is stored.
    pub enum PixelFormat {
        /// Red, green, blue; a byte each.
        Rgb8 = 0 "rgb8",
    }
}

crate::message! {
    /// A pinhole or orthographic camera: where a point of the body frame is seen.
    #[derive(Default)]
    pub struct Camera: 136 bytes {
        /// Row-major 3 x 4 matrix from homogeneous body coordinates (m; x forward,
        /// y left, z up) to homogeneous pixels (u right, v down).
        pub pixel_from_body: [f64; 12],
        /// Position of the camera in the body frame, m.
        pub position_body_m: [f64; 3],
        /// Points nearer than this are not seen, m; for orthographic views 0.
        pub near_m: f64,
        /// A [`View`].
        pub view: u32,
        /// 1 for an orthographic projection, 0 for a pinhole.
        pub orthographic: u32,
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

impl Message for Frame {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        for value in self.camera.pixel_from_body {
            within("camera.pixel_from_body", value, -1e9..=1e9)?;
        }
        for value in self.camera.position_body_m {
            within("camera.position_body_m", value, -1e4..=1e4)?;
        }
        within("camera.near_m", self.camera.near_m, 0.0..=1e3)?;
        known("camera.view", self.camera.view, View::from_code)?;
        known("format", self.format, PixelFormat::from_code)?;
        let bytes = u64::from(self.width) * u64::from(self.height) * 3;
        fits("width * height * 3", bytes, FRAME_BYTES_MAX)
    }
}
