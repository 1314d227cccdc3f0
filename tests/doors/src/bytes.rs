//! Messages as bytes, as a hostile publisher writes them.

use shm_config::Message;

/// A message whose memory begins with these bytes; zeros follow.
pub fn read<M: Message>(bytes: &[u8]) -> Box<M> {
    let mut room = Box::<M>::new_zeroed();
    let count = bytes.len().min(size_of::<M>());
    // SAFETY: the box has `size_of::<M>()` bytes, `count` is at most that, and source
    // and target do not overlap. Messages are `repr(C)` and consist of numbers and
    // arrays of them, so any bytes are a valid message; shared memory requires the
    // same.
    #[allow(unsafe_code)]
    unsafe {
        let to = room.as_mut_ptr().cast::<u8>();
        std::ptr::copy_nonoverlapping(bytes.as_ptr(), to, count);
        room.assume_init()
    }
}

/// The memory of a message.
pub fn as_bytes<M: Message>(message: &M) -> Vec<u8> {
    // SAFETY: `message!` asserts that no message has padding, so that each of its
    // bytes is defined; the slice lives no longer than the borrow.
    #[allow(unsafe_code)]
    let bytes = unsafe {
        std::slice::from_raw_parts(std::ptr::from_ref(message).cast::<u8>(), size_of::<M>())
    };
    bytes.to_vec()
}

#[cfg(test)]
mod tests {
    use shm_config::message::{Command, Step, Takeover};

    use super::*;

    #[test]
    fn a_message_survives_as_bytes() {
        let mut takeover = Takeover {
            steer: -0.5,
            active: 1,
            ..Takeover::default()
        };
        takeover.header.tick = 7;
        let bytes = as_bytes(&takeover);
        assert_eq!(bytes.len(), size_of::<Takeover>());
        assert_eq!(*read::<Takeover>(&bytes), takeover);
    }

    #[test]
    fn too_few_bytes_are_zeros_and_too_many_are_cut() {
        let ones = [0xff; 64];
        let command = *read::<Command>(&ones[..8]);
        assert_eq!((command.header.tick, command.reason), (u64::MAX, 0));
        assert!(read::<Command>(&ones).check().is_err());
        assert_eq!(read::<Step>(&[]).command.steer, 0.0);
    }
}
