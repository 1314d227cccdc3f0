//! XCDR1, little-endian: the encoding of ROS 2 messages.

use super::messages::Frames;
use crate::schema::ENCAPSULATION;

/// A message that is written field by field. A field is aligned to its size, counted from
/// behind the encapsulation.
#[derive(Debug, Default)]
pub(super) struct Cdr {
    bytes: Vec<u8>,
    /// How the frames are named in it.
    pub(super) frames: Frames,
}

impl Cdr {
    /// Begins another message.
    pub(super) fn begin(&mut self) -> &mut Self {
        self.bytes.clear();
        self.bytes.extend_from_slice(&ENCAPSULATION);
        self
    }

    /// A string that is one of the frames' names.
    pub(super) fn frame(&mut self, name: impl Fn(&Frames) -> &str) -> &mut Self {
        let frames = std::mem::take(&mut self.frames);
        self.text(name(&frames));
        self.frames = frames;
        self
    }

    /// The message so far.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    fn put<const N: usize>(&mut self, bytes: [u8; N]) -> &mut Self {
        let behind = self.bytes.len() - ENCAPSULATION.len();
        let to = ENCAPSULATION.len() + behind.next_multiple_of(N);
        self.bytes.resize(to, 0);
        self.bytes.extend_from_slice(&bytes);
        self
    }

    pub(super) fn u8(&mut self, value: u8) -> &mut Self {
        self.put([value])
    }

    pub(super) fn u32(&mut self, value: u32) -> &mut Self {
        self.put(value.to_le_bytes())
    }

    pub(super) fn i32(&mut self, value: i32) -> &mut Self {
        self.put(value.to_le_bytes())
    }

    pub(super) fn f32(&mut self, value: f32) -> &mut Self {
        self.put(value.to_le_bytes())
    }

    pub(super) fn f64(&mut self, value: f64) -> &mut Self {
        self.put(value.to_le_bytes())
    }

    pub(super) fn f64s<const N: usize>(&mut self, values: [f64; N]) -> &mut Self {
        values.into_iter().fold(self, Self::f64)
    }

    pub(super) fn f32s<const N: usize>(&mut self, values: [f32; N]) -> &mut Self {
        values.into_iter().fold(self, Self::f32)
    }

    /// The count of a sequence, whose elements follow. More than 2^32 never fit in memory.
    pub(super) fn count(&mut self, count: usize) -> &mut Self {
        self.u32(count as u32)
    }

    /// A sequence of bytes.
    pub(super) fn octets(&mut self, octets: &[u8]) -> &mut Self {
        self.count(octets.len());
        self.bytes.extend_from_slice(octets);
        self
    }

    /// A string, ended by a zero that counts in its length.
    pub(super) fn text(&mut self, text: &str) -> &mut Self {
        self.count(text.len() + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_aligned_behind_the_encapsulation() {
        let mut cdr = Cdr::default();
        cdr.begin().text("ab").u32(7).u8(1).f64(0.5);
        let expected = [
            &ENCAPSULATION[..],
            &[3, 0, 0, 0, b'a', b'b', 0, 0],
            &[7, 0, 0, 0, 1, 0, 0, 0],
            &0.5_f64.to_le_bytes(),
        ];
        assert_eq!(cdr.bytes(), expected.concat());
        cdr.begin().octets(&[9, 8, 7]).f32(1.0);
        let expected = [
            &ENCAPSULATION[..],
            &[3, 0, 0, 0, 9, 8, 7, 0],
            &1_f32.to_le_bytes(),
        ];
        assert_eq!(cdr.bytes(), expected.concat());
    }
}
