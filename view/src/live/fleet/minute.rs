//! Who drove in the last minute, half a second by half a second.

use std::collections::VecDeque;

use shm_config::Instant;
use shm_config::message::Driver;

use crate::live::history::Sample;

/// Parts of the minute.
pub const PARTS_MAX: usize = 120;
/// Length of a part, ns.
const PART_NS: u64 = 500_000_000;
/// The bit of a part in which something happened that is worth a look.
pub const MARK: u8 = 1 << 7;

/// The last minute by the machine's clock: the drivers of each part as bits, in the order
/// of `Driver::ALL`, and [`MARK`].
#[derive(Debug, Clone, Default)]
pub struct Minute {
    parts: VecDeque<u8>,
    /// Number of the newest part since the clock's zero.
    newest: u64,
    /// Number of the part to which steps were last added.
    added: u64,
    driver: u8,
}

impl Minute {
    /// Adds the steps of a sample, and whether they had an event worth a look.
    pub fn add(&mut self, sample: Option<&Sample>, is_marked: bool, now: Instant) {
        self.advance(now);
        let mut bits = if is_marked { MARK } else { 0 };
        if let Some(sample) = sample {
            // A sample names the driver where it changes; until then the last one drives.
            let first = sample.drivers.first().map_or(u64::MAX, |change| change.0);
            let steps = u64::from(sample.steps);
            if first.saturating_add(steps) > sample.tick.saturating_add(1) {
                bits |= self.driver;
            }
            for (_, code, _) in &sample.drivers {
                self.driver = bit(*code);
                bits |= self.driver;
            }
        }
        let mut latest = self.parts.iter_mut().rev();
        if let Some(part) = latest.next() {
            *part |= bits;
        }
        if sample.is_none() {
            return;
        }
        // A sample is of about one part and may pass over one whole: its steps are of both.
        if let (Some(part), 2) = (latest.next(), self.newest - self.added) {
            *part |= bits & !MARK;
        }
        self.added = self.newest;
    }

    /// The parts until now, the oldest first.
    pub fn parts(&self) -> Vec<u8> {
        self.parts.iter().copied().collect()
    }

    /// Begins the parts that have come since the last one; they are empty.
    pub fn advance(&mut self, now: Instant) {
        let part = now.0 / PART_NS;
        let passed = match self.parts.is_empty() {
            true => 1,
            false => part.saturating_sub(self.newest),
        };
        for _ in 0..passed.min(PARTS_MAX as u64) {
            self.parts.push_back(0);
            if self.parts.len() > PARTS_MAX {
                self.parts.pop_front();
            }
        }
        self.newest = self.newest.max(part);
    }
}

/// The bit of a driver's code; none for an unknown one.
fn bit(code: u32) -> u8 {
    let index = Driver::ALL.iter().position(|driver| driver.code() == code);
    index.map_or(0, |index| 1 << index)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::history::History;
    use shm_config::message::{Reason, Step};

    fn at(parts: u64) -> Instant {
        Instant(1_000 * PART_NS + parts * PART_NS)
    }

    fn sample(history: &mut History, drivers: &[(u64, Driver)]) -> Option<Sample> {
        for (tick, driver) in drivers {
            let mut step = Step::default();
            step.header.tick = *tick;
            (step.command.driver, step.command.reason) = (driver.code(), Reason::Advised.code());
            history.add(&step);
        }
        history.take()
    }

    #[test]
    fn a_part_has_every_driver_of_its_steps_and_none_where_no_step_came() {
        let (mut history, mut minute) = (History::default(), Minute::default());
        let (expert, policy) = (bit(Driver::Expert.code()), bit(Driver::Policy.code()));
        let first = sample(&mut history, &[(1, Driver::Expert)]);
        minute.add(first.as_ref(), false, at(0));
        let second = sample(&mut history, &[(2, Driver::Expert), (3, Driver::Expert)]);
        minute.add(second.as_ref(), false, at(1));
        let third = sample(&mut history, &[(4, Driver::Expert), (5, Driver::Policy)]);
        minute.add(third.as_ref(), true, at(2));
        minute.add(None, false, at(4));
        minute.add(None, false, at(5));
        let fourth = sample(&mut history, &[(6, Driver::Policy)]);
        minute.add(fourth.as_ref(), false, at(6));
        let expected = [expert, expert, expert | policy | MARK, 0, 0, 0, policy];
        assert_eq!(minute.parts(), expected);
    }

    #[test]
    fn a_sample_that_passes_over_a_part_fills_it() {
        let (mut history, mut minute) = (History::default(), Minute::default());
        for (tick, part) in [(1, 0), (2, 1), (3, 3), (4, 6)] {
            let sample = sample(&mut history, &[(tick, Driver::Expert)]);
            minute.add(sample.as_ref(), part == 3, at(part));
        }
        let one = bit(Driver::Expert.code());
        assert_eq!(minute.parts(), [one, one, one, one | MARK, 0, 0, one]);
    }

    #[test]
    fn it_holds_a_minute_however_long_the_pause() {
        let mut minute = Minute::default();
        let mut history = History::default();
        let driven = sample(&mut history, &[(1, Driver::Brake)]);
        minute.add(driven.as_ref(), false, at(0));
        minute.advance(at(119));
        assert_eq!(minute.parts().len(), PARTS_MAX);
        assert_ne!(minute.parts()[0], 0);
        minute.advance(at(120));
        assert_eq!(minute.parts(), [0; PARTS_MAX]);
        minute.advance(at(1_000_000_000));
        assert_eq!(minute.parts().len(), PARTS_MAX);
    }
}
