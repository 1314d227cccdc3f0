//! The bounded queue between the thread that drains and the one that writes.

use rtrb::{Consumer, Producer, RingBuffer};

use crate::write::Stamp;

/// Bytes of the queue: at 1,000 Hz three seconds, at 10 Hz half a minute; it holds three
/// offers of weights.
pub(super) const RING_BYTES: usize = 32 << 20;

/// Bytes before each message.
const HEAD: usize = 32;

/// A message's place: the number of its channel in the order of the taps, and its times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Label {
    pub(super) channel: usize,
    pub(super) stamp: Stamp,
}

/// The end that is written.
pub(super) struct RingIn(Producer<u8>);

/// The end that is read.
pub(super) struct RingOut(Consumer<u8>);

/// A queue of this many bytes.
pub(super) fn ring(bytes: usize) -> (RingIn, RingOut) {
    let (producer, consumer) = RingBuffer::new(bytes);
    (RingIn(producer), RingOut(consumer))
}

impl RingIn {
    /// Appends a message; returns whether there was room. Never waits.
    pub(super) fn push(&mut self, label: Label, cdr: &[u8]) -> bool {
        let Ok(mut chunk) = self.0.write_chunk(HEAD + cdr.len()) else {
            return false;
        };
        let numbers = [
            ((cdr.len() as u64) << 16) | label.channel as u64,
            label.stamp.recorded_ns,
            label.stamp.taken_ns,
            label.stamp.sequence,
        ];
        let (first, second) = chunk.as_mut_slices();
        let mut at = 0;
        let mut put = |bytes: &[u8]| {
            let split = first.len().saturating_sub(at).min(bytes.len());
            if split > 0 {
                first[at..at + split].copy_from_slice(&bytes[..split]);
            }
            if split < bytes.len() {
                let from = at + split - first.len();
                second[from..from + bytes.len() - split].copy_from_slice(&bytes[split..]);
            }
            at += bytes.len();
        };
        numbers.iter().for_each(|number| put(&number.to_le_bytes()));
        put(cdr);
        chunk.commit_all();
        true
    }

    /// Whether the reading end has ended.
    pub(super) fn is_abandoned(&self) -> bool {
        self.0.is_abandoned()
    }
}

impl RingOut {
    /// Takes the next message into `cdr`; `None` when there is none.
    pub(super) fn pop(&mut self, cdr: &mut Vec<u8>) -> Option<Label> {
        let head = self.0.read_chunk(HEAD).ok()?;
        let mut bytes = [0; HEAD];
        let (first, second) = head.as_slices();
        bytes[..first.len()].copy_from_slice(first);
        bytes[first.len()..].copy_from_slice(second);
        head.commit_all();
        let number = |at: usize| {
            let mut number = [0; 8];
            number.copy_from_slice(&bytes[8 * at..8 * at + 8]);
            u64::from_le_bytes(number)
        };
        // A message is committed whole.
        let body = self.0.read_chunk((number(0) >> 16) as usize).ok()?;
        let (first, second) = body.as_slices();
        cdr.clear();
        cdr.extend_from_slice(first);
        cdr.extend_from_slice(second);
        body.commit_all();
        Some(Label {
            channel: (number(0) & 0xffff) as usize,
            stamp: Stamp {
                recorded_ns: number(1),
                taken_ns: number(2),
                sequence: number(3),
            },
        })
    }

    /// Whether the writing end has ended; what it wrote can still be read.
    pub(super) fn is_abandoned(&self) -> bool {
        self.0.is_abandoned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_come_out_as_they_went_in_across_the_end_of_the_memory() {
        let (mut into, mut out) = ring(1000);
        let mut cdr = Vec::new();
        for round in 0..200_u64 {
            let body: Vec<u8> = (0..(round * 7) % 300).map(|k| (k + round) as u8).collect();
            let stamp = Stamp {
                recorded_ns: round,
                taken_ns: u64::MAX - round,
                sequence: 3 * round,
            };
            let label = Label {
                channel: (round % 40) as usize,
                stamp,
            };
            assert!(into.push(label, &body), "round {round}");
            assert!(into.push(label, &[]), "round {round}");
            assert_eq!(out.pop(&mut cdr), Some(label));
            assert_eq!(cdr, body, "round {round}");
            assert_eq!(out.pop(&mut cdr), Some(label));
            assert!(cdr.is_empty());
            assert_eq!(out.pop(&mut cdr), None);
        }
    }

    #[test]
    fn a_full_ring_refuses_and_loses_nothing() {
        let (mut into, mut out) = ring(100);
        let label = Label {
            channel: 1,
            stamp: Stamp::default(),
        };
        assert!(into.push(label, &[1; 60]));
        assert!(!into.push(label, &[2; 60]));
        let mut cdr = Vec::new();
        assert_eq!(out.pop(&mut cdr), Some(label));
        assert_eq!(cdr, [1; 60]);
        assert!(into.push(label, &[2; 60]));
        drop(into);
        assert!(out.is_abandoned());
        assert_eq!(out.pop(&mut cdr), Some(label));
        assert_eq!(cdr, [2; 60]);
    }
}
