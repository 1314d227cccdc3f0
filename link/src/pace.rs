//! How much of what a peer may send is taken. A peer that sends more costs the vehicle no
//! more than one that does not; what is over the limit waits until a newer message replaces
//! it, or is counted as a flood.

use std::sync::Arc;

use shm_config::Instant;

use crate::flow::{QUEUE_MAX, WINDOW_NEWEST};
use crate::host::Event;
use crate::refusal::Reason;
use crate::role::RowId;

/// Pieces of advice that are looked at in one turn: as many as a peer may have on the way.
const ADVICES_MAX: usize = WINDOW_NEWEST as usize;

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

/// One message in a time, where the newest one is of use later, too: it waits until its time
/// has come.
#[derive(Debug)]
pub struct Paced<T> {
    pace: Pace,
    waiting: Option<T>,
}

impl<T> Paced<T> {
    /// One message in `least_ns`; each of them without a wait for 0.
    pub fn new(least_ns: u64) -> Self {
        Self {
            pace: Pace::new(least_ns),
            waiting: None,
        }
    }

    /// Adds a message; the one that it replaces.
    pub fn put(&mut self, message: T) -> Option<T> {
        self.waiting.replace(message)
    }

    /// The message whose time has come.
    pub fn take_due(&mut self, now: Instant) -> Option<T> {
        self.waiting.as_ref()?;
        self.pace.take(now).ok()?;
        self.waiting.take()
    }
}

/// One answer for each question, of as many questions as can wait to be sent.
#[derive(Debug, Default)]
pub struct Owed(u64);

impl Owed {
    /// A question was sent.
    pub fn add(&mut self) {
        self.0 = (self.0 + 1).min(QUEUE_MAX as u64);
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

    /// A learner that has answered nothing for an hour may not answer all of it at once.
    #[test]
    fn no_more_answers_are_owed_than_questions_can_wait() {
        let mut owed = Owed::default();
        (0..QUEUE_MAX + 9).for_each(|_| owed.add());
        assert_eq!((0..).take_while(|_| owed.take().is_ok()).count(), QUEUE_MAX);
    }

    /// What comes at these instants, with the instants at which it is taken, and what was
    /// replaced, with a look each ms.
    fn paced(least_ms: u64, comes_ms: &[u64]) -> (Vec<(u64, u64)>, Vec<u64>) {
        const MS: u64 = 1_000_000;
        let mut paced = Paced::new(least_ms * MS);
        let (mut taken, mut replaced) = (Vec::new(), Vec::new());
        for now_ms in 0..10_000 {
            if comes_ms.contains(&now_ms) {
                replaced.extend(paced.put(now_ms));
            }
            let due = paced.take_due(Instant(now_ms * MS));
            taken.extend(due.map(|came_ms| (came_ms, now_ms)));
        }
        (taken, replaced)
    }

    #[test]
    fn a_message_before_its_time_waits_unless_a_newer_one_replaces_it() {
        // Two policies half a second apart.
        let (taken, replaced) = paced(1_000, &[200, 700]);
        assert_eq!(taken, [(200, 200), (700, 1_200)]);
        assert!(replaced.is_empty());
        let (taken, replaced) = paced(1_000, &[200, 700, 900, 1_201, 5_000]);
        let expected = [(200, 200), (900, 1_200), (1_201, 2_200), (5_000, 5_000)];
        assert_eq!(taken, expected);
        assert_eq!(replaced, [700]);
        // In lockstep none waits.
        let (taken, replaced) = paced(0, &[200, 201]);
        assert_eq!(taken, [(200, 200), (201, 201)]);
        assert!(replaced.is_empty());
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
