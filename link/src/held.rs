//! Messages of the vehicle that wait until the program on this machine takes them.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::flow::{QUEUE_BYTES_MAX, QUEUE_MAX};
use crate::role::{Passage, Role, RowId};

/// Messages that wait: of newest rows the newest, of others as many as a reader on the
/// machine may fall behind.
#[derive(Debug, Default)]
pub struct Held {
    messages: VecDeque<(RowId, Arc<[u8]>)>,
    bytes: usize,
    /// Messages that were dropped here, although the vehicle was told that they have come.
    pub dropped: u64,
}

impl Held {
    /// Adds a message.
    pub fn push(&mut self, role: Role, row: RowId, bytes: Arc<[u8]>) {
        if row.passage(role) == Passage::Newest {
            // One that is replaced is not lost: of its row only the newest counts.
            let freed = &mut self.bytes;
            self.messages.retain(|(held, old)| {
                let stays = *held != row;
                *freed -= if stays { 0 } else { old.len() };
                stays
            });
        }
        self.bytes += bytes.len();
        self.messages.push_back((row, bytes));
        while self.messages.len() > QUEUE_MAX || self.bytes > QUEUE_BYTES_MAX {
            let Some((_, old)) = self.messages.pop_front() else {
                return;
            };
            self.bytes -= old.len();
            self.dropped += 1;
        }
    }

    /// The next message.
    pub fn pop(&mut self) -> Option<(RowId, Arc<[u8]>)> {
        let (row, bytes) = self.messages.pop_front()?;
        self.bytes -= bytes.len();
        Some((row, bytes))
    }

    /// Drops the messages of a run that has ended.
    pub fn clear(&mut self) {
        self.dropped += self.messages.len() as u64;
        self.messages.clear();
        self.bytes = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shm_config::services::{FRAME, STEP};

    #[test]
    fn the_newest_and_every_step_wait_and_what_is_dropped_is_counted() {
        let [step, frame] = [STEP.name, FRAME.name].map(|name| RowId::of(name).expect("a row"));
        let mut held = Held::default();
        let number = |k: u64| -> Arc<[u8]> { k.to_le_bytes()[..].into() };
        held.push(Role::View, frame, number(1));
        held.push(Role::View, frame, number(2));
        for k in 1..=QUEUE_MAX as u64 + 9 {
            held.push(Role::View, step, number(k));
        }
        // The picture and nine steps.
        assert_eq!(held.dropped, 10);
        assert_eq!(held.pop(), Some((step, number(10))));
        held.clear();
        assert_eq!((held.pop(), held.bytes), (None, 0));
        assert_eq!(held.dropped, 9 + QUEUE_MAX as u64);
        // A judge is asked about the newest step alone.
        held.push(Role::Judge, step, number(1));
        held.push(Role::Judge, step, number(2));
        assert_eq!(held.pop(), Some((step, number(2))));
        assert_eq!(held.pop(), None);
    }
}
