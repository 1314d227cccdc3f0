//! How much of what a peer may send is taken. A peer that sends more costs the vehicle no
//! more than one that does not; what is over the limit is counted as a flood.

use std::sync::Arc;

use shm_config::Instant;

use crate::host::Event;
use crate::refusal::Reason;
use crate::role::RowId;

/// Pieces of advice that are looked at in one turn: as many as a peer may have on the way.
const ADVICES_MAX: usize = 8;

/// One message in a time.
#[derive(Debug)]
pub struct Pace {
    least_ns: u64,
    last: Option<Instant>,
}

impl Pace {
    /// One message in `least_ns`.
    pub fn new(least_ns: u64) -> Self {
        Self {
            least_ns,
            last: None,
        }
    }

    /// Takes a message at an instant.
    ///
    /// # Errors
    /// When the last one that was taken is not long enough ago.
    pub fn take(&mut self, now: Instant) -> Result<(), Reason> {
        match self.last {
            Some(last) if now.since_ns(last) < self.least_ns => Err(Reason::Flooded),
            _ => {
                self.last = Some(now);
                Ok(())
            }
        }
    }
}

/// One answer for each question.
#[derive(Debug, Default)]
pub struct Owed(u64);

impl Owed {
    /// A question was sent.
    pub fn add(&mut self) {
        self.0 = self.0.saturating_add(1);
    }

    /// Takes an answer.
    ///
    /// # Errors
    /// When all questions are answered.
    pub fn take(&mut self) -> Result<(), Reason> {
        self.0 = self.0.checked_sub(1).ok_or(Reason::Flooded)?;
        Ok(())
    }
}

/// Takes the messages of a row out of what happened in one turn: the newest ones, the newest
/// first, and how many more there were.
pub fn newest(events: &mut Vec<Event>, row: RowId) -> (Vec<Arc<[u8]>>, u64) {
    let of_row = |event: &mut Event| matches!(event, Event::Message(_, is, _) if *is == row);
    let messages = events.extract_if(.., of_row);
    let mut messages: Vec<_> = messages
        .filter_map(|event| match event {
            Event::Message(_, _, bytes) => Some(bytes),
            _ => None,
        })
        .collect();
    messages.reverse();
    let over = messages.len().saturating_sub(ADVICES_MAX);
    messages.truncate(ADVICES_MAX);
    (messages, over as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keys::{Claim, Identity};
    use crate::role::Role;

    #[test]
    fn a_pace_takes_one_message_in_its_time() {
        let mut pace = Pace::new(1_000);
        let taken = [5, 900, 1_004, 1_005, 1_006, 9_000].map(|at| pace.take(Instant(at)).is_ok());
        assert_eq!(taken, [true, false, false, true, false, true]);
    }

    #[test]
    fn each_question_has_one_answer() {
        let mut owed = Owed::default();
        assert_eq!(owed.take(), Err(Reason::Flooded));
        owed.add();
        owed.add();
        let taken = [(); 3].map(|()| owed.take().is_ok());
        assert_eq!(taken, [true, true, false]);
    }

    #[test]
    fn of_many_messages_in_one_turn_the_newest_are_looked_at() {
        let claim = Claim {
            run: Identity([0; 16]),
            peer: Identity([1; 16]),
            role: Role::Judge,
            expires_epoch_s: 1,
            signer: [0; 32],
        };
        let [row, other] = [RowId(7), RowId(8)];
        let mut events = vec![Event::Joined(claim)];
        for number in 0..20_u8 {
            events.push(Event::Message(claim, row, [number][..].into()));
        }
        events.push(Event::Message(claim, other, [0][..].into()));
        let (messages, over) = newest(&mut events, row);
        let numbers: Vec<u8> = messages.iter().map(|bytes| bytes[0]).collect();
        assert_eq!(numbers, (12..20).rev().collect::<Vec<_>>());
        assert_eq!((over, events.len()), (12, 2));
    }
}
