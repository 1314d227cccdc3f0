//! The frames on the serial line: postcard in COBS, so that a zero byte ends each frame and
//! a reader that joins late or loses bytes finds the next one; and a CRC-32, because a
//! line has none.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use shm_config::message::BEAMS_MAX;

/// Longest frame, bytes: four for each range, one in 254 for the zero bytes, and the rest of
/// a report.
const FRAME_MAX: usize = 4 * BEAMS_MAX + 4 * BEAMS_MAX / 254 + 64;
/// Bytes of the checksum at the end of a body.
const CRC: usize = 4;

/// What the machine is to do until the next order. A machine that gets none for a quarter
/// of a second has to brake by itself: the host may be gone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Order {
    /// Normalised, [-1, 1], positive left.
    pub steer: f32,
    /// Normalised, [-1, 1], negative brakes.
    pub pedal: f32,
}

/// A body as a frame with its end.
pub fn frame<T: Serialize>(body: &T) -> Vec<u8> {
    // Writing numbers to memory has no error.
    let mut bytes = postcard::to_stdvec(body).unwrap_or_default();
    bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
    postcard::to_stdvec_cobs(&bytes).unwrap_or_default()
}

fn body<T: DeserializeOwned>(frame: &mut [u8]) -> Option<T> {
    let bytes: Vec<u8> = postcard::from_bytes_cobs(frame).ok()?;
    let (body, crc) = bytes.split_at(bytes.len().checked_sub(CRC)?);
    let is_whole = crc32fast::hash(body).to_le_bytes() == crc;
    is_whole.then(|| postcard::from_bytes(body).ok()).flatten()
}

/// Finds the frames in a stream of bytes.
#[derive(Default)]
pub struct Frames {
    bytes: Vec<u8>,
    /// How often bytes were dropped because a frame was longer than any report.
    pub too_long: u64,
}

impl Frames {
    /// Takes bytes as they arrive; returns the newest body that ended with them. Broken
    /// frames are dropped.
    pub fn newest<T: DeserializeOwned>(&mut self, arrived: &[u8]) -> Option<T> {
        let mut newest = None;
        for byte in arrived {
            self.bytes.push(*byte);
            if *byte == 0 {
                newest = body(&mut self.bytes).or(newest);
                self.bytes.clear();
            } else if self.bytes.len() >= FRAME_MAX {
                self.bytes.clear();
                self.too_long += 1;
            }
        }
        newest
    }
}
