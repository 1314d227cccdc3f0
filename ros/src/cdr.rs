//! Reads CDR of foreign processes. Every length in it may be wrong: nothing is read, and no
//! memory is reserved, beyond the bytes that are there.

/// Why bytes are not the message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// They end before the message does, or a length in them is larger than what is there.
    #[error("the message is shorter than it says")]
    Short,
    /// They do not begin as CDR of ROS 2.
    #[error("the message is not little-endian or big-endian CDR")]
    Encapsulation,
    /// A sequence or string is longer than this reader takes.
    #[error("a sequence is longer than this reader takes")]
    Long,
    /// A string is not UTF-8 or not ended by a zero.
    #[error("a string is no text")]
    Text,
}

/// Longest string, bytes: a frame's name.
const TEXT_MAX: usize = 256;

/// A message that is read field by field.
#[derive(Debug, Clone)]
pub struct Reader<'a> {
    /// Behind the encapsulation.
    bytes: &'a [u8],
    at: usize,
    is_little: bool,
}

impl<'a> Reader<'a> {
    /// Begins to read a message.
    ///
    /// # Errors
    /// When it does not begin as CDR.
    pub fn new(bytes: &'a [u8]) -> Result<Self, CdrError> {
        let (kind, bytes) = bytes.split_at_checked(4).ok_or(CdrError::Short)?;
        let is_little = match kind {
            [0, 1, _, _] => true,
            [0, 0, _, _] => false,
            _ => return Err(CdrError::Encapsulation),
        };
        let at = 0;
        Ok(Self {
            bytes,
            at,
            is_little,
        })
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        // Both numbers are at most the length of the message and a few bytes.
        let from = self.at.next_multiple_of(N);
        let bytes = self.bytes.get(from..from + N).ok_or(CdrError::Short)?;
        self.at = from + N;
        let mut array: [u8; N] = bytes.try_into().map_err(|_| CdrError::Short)?;
        if !self.is_little {
            array.reverse();
        }
        Ok(array)
    }

    /// A number.
    ///
    /// # Errors
    /// At the end of the bytes.
    pub fn u32(&mut self) -> Result<u32, CdrError> {
        self.take().map(u32::from_le_bytes)
    }

    /// A signed number.
    ///
    /// # Errors
    /// At the end of the bytes.
    pub fn i32(&mut self) -> Result<i32, CdrError> {
        self.take().map(i32::from_le_bytes)
    }

    /// A number that may be infinite or NaN.
    ///
    /// # Errors
    /// At the end of the bytes.
    pub fn f32(&mut self) -> Result<f32, CdrError> {
        self.take().map(f32::from_le_bytes)
    }

    /// A number that may be infinite or NaN.
    ///
    /// # Errors
    /// At the end of the bytes.
    pub fn f64(&mut self) -> Result<f64, CdrError> {
        self.take().map(f64::from_le_bytes)
    }

    /// Several of them.
    ///
    /// # Errors
    /// At the end of the bytes.
    pub fn f64s<const N: usize>(&mut self) -> Result<[f64; N], CdrError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    /// The count of a sequence whose elements have at least so many bytes.
    ///
    /// # Errors
    /// More than `most`, or more than the bytes that are left can hold.
    pub fn count(&mut self, least_bytes: usize, most: usize) -> Result<usize, CdrError> {
        let count = self.u32()? as usize;
        let left = self.bytes.len() - self.at;
        match count {
            count if count > left / least_bytes.max(1) => Err(CdrError::Short),
            count if count > most => Err(CdrError::Long),
            count => Ok(count),
        }
    }

    /// A string; some writers send an empty one without its zero.
    ///
    /// # Errors
    /// A wrong length, or bytes that are no text.
    pub fn text(&mut self) -> Result<&'a str, CdrError> {
        let count = self.count(1, TEXT_MAX)?;
        let bytes = &self.bytes[self.at..self.at + count];
        self.at += count;
        let text = match bytes {
            [] => bytes,
            [text @ .., 0] => text,
            _ => return Err(CdrError::Text),
        };
        std::str::from_utf8(text).map_err(|_| CdrError::Text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_read_as_they_are_aligned_in_both_byte_orders() {
        let little = [
            0, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 0, 7, 0, 0, 0, 0, 0, 0, 0,
        ];
        let mut reader = Reader::new(&little).expect("CDR");
        assert_eq!(reader.text(), Ok("ab"));
        assert_eq!(reader.u32(), Ok(7));
        assert_eq!(reader.u32(), Ok(0));
        assert_eq!(reader.u32(), Err(CdrError::Short));
        let mut reader = Reader::new(&[0, 0, 0, 0, 0, 0, 0, 9]).expect("CDR");
        assert_eq!(reader.u32(), Ok(9));
    }

    #[test]
    fn a_hostile_length_reserves_and_reads_nothing() {
        let claims = |count: u32| {
            let mut bytes = vec![0, 1, 0, 0];
            bytes.extend(count.to_le_bytes());
            bytes.extend([b'x'; 300]);
            bytes
        };
        for count in [u32::MAX, u32::MAX - 3, 301, 1 << 31] {
            let bytes = claims(count);
            assert_eq!(
                Reader::new(&bytes).and_then(|mut reader| reader.text()),
                Err(CdrError::Short)
            );
            let count = Reader::new(&bytes).and_then(|mut reader| reader.count(4, usize::MAX));
            assert_eq!(count, Err(CdrError::Short));
        }
        let bytes = claims(300);
        assert_eq!(
            Reader::new(&bytes).and_then(|mut reader| reader.text()),
            Err(CdrError::Long)
        );
        let bytes = claims(4);
        assert_eq!(
            Reader::new(&bytes).and_then(|mut reader| reader.text()),
            Err(CdrError::Text)
        );
        let bytes = [0, 1, 0, 0, 2, 0, 0, 0, 0xff, 0];
        assert_eq!(
            Reader::new(&bytes).and_then(|mut reader| reader.text()),
            Err(CdrError::Text)
        );
        assert!(matches!(
            Reader::new(&[0, 3, 0, 0]),
            Err(CdrError::Encapsulation)
        ));
        assert!(matches!(Reader::new(&[0, 1]), Err(CdrError::Short)));
    }
}
