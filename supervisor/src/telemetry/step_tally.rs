//! The sums over the steps of a run.

use std::collections::BTreeMap;

use shm_config::Instant;
use shm_config::message::{Driver, Reason, Step};

use crate::telemetry::process_tally::LIVES_APART;

/// Versions of the weights that are kept apart: a run may swap without limit.
pub const WEIGHTS_KEPT: usize = 1000;

/// Steps by driver, reason and weights.
#[derive(Debug, Default)]
pub struct StepTally {
    /// Steps read.
    pub received: u64,
    /// When the first one was taken, on the run's clock.
    pub begun: Option<Instant>,
    /// When the first command went out, on the machine's clock.
    pub first_commanded: Option<Instant>,
    /// The newest driver and reason.
    pub newest: Option<(Driver, Reason)>,
    counts: BTreeMap<(u32, u32), u64>,
    weights: BTreeMap<(u64, u64), WeightsTally>,
    /// The newest sequence number of each of the newest controllers.
    last_sequences: Vec<(u32, u64)>,
    /// Steps of older controllers.
    sent_before: u64,
    /// The first instant after the world's last tick.
    pub(super) end: Option<Instant>,
    pub(super) is_closed: bool,
}

/// The steps of one version of the weights.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct WeightsTally {
    /// Steps in which they proposed.
    pub proposed: u64,
    /// Steps in which they drove.
    pub drove: u64,
}

impl StepTally {
    pub(super) fn count(&mut self, step: &Step) {
        self.received += 1;
        let header = &step.header;
        self.begun.get_or_insert(header.taken());
        self.first_commanded
            .get_or_insert(Instant(step.timings.commanded_ns));
        self.count_sequence(header.producer, header.sequence);
        let (driver, reason) = (step.driver(), step.reason());
        let reason_code = reason.map_or(u32::MAX, Reason::code);
        *self.counts.entry((driver.code(), reason_code)).or_default() += 1;
        if step.weights_version > 0 {
            let key = (step.weights_version, step.weights_hash);
            let weights = self.weights.entry(key).or_default();
            weights.proposed += 1;
            weights.drove += u64::from(driver == Driver::Policy);
            if self.weights.len() > WEIGHTS_KEPT {
                self.weights.pop_first();
            }
        }
        self.newest = Some((driver, reason.unwrap_or(Reason::Blind)));
    }

    fn count_sequence(&mut self, producer: u32, sequence: u64) {
        let mut known = self.last_sequences.iter_mut();
        match known.find(|(pid, _)| *pid == producer) {
            Some((_, last)) => *last = sequence,
            None => self.last_sequences.push((producer, sequence)),
        }
        if self.last_sequences.len() > LIVES_APART {
            self.sent_before += self.last_sequences.remove(0).1;
        }
    }

    /// Steps that were overwritten before they were read. Each producer numbers its steps
    /// from 1, and the subscriber exists before the first.
    pub fn lost(&self) -> u64 {
        let sent: u64 = self.last_sequences.iter().map(|(_, last)| last).sum();
        (self.sent_before + sent).saturating_sub(self.received)
    }

    /// Version, first 8 bytes of the SHA-256, and steps of each version of the weights, the
    /// oldest first; of a run with more, the last [`WEIGHTS_KEPT`].
    pub fn weights(&self) -> impl Iterator<Item = (u64, u64, WeightsTally)> + '_ {
        let all = self.weights.iter();
        all.map(|(&(version, hash), &counted)| (version, hash, counted))
    }

    /// Steps driven by one driver, for any reason.
    pub fn driven_by(&self, driver: Driver) -> u64 {
        self.counts
            .iter()
            .filter(|((code, _), _)| *code == driver.code())
            .map(|(_, count)| count)
            .sum()
    }

    /// Share of the steps read that one driver drove, [0, 1]; 0 without steps.
    pub fn share(&self, driver: Driver) -> f64 {
        match self.received {
            0 => 0.0,
            received => self.driven_by(driver) as f64 / received as f64,
        }
    }

    /// Steps by driver and reason, in the order of the two lists.
    pub fn reasons(&self) -> impl Iterator<Item = (Driver, &'static str, u64)> + '_ {
        self.counts.iter().map(|(&(driver, reason), &count)| {
            let driver = Driver::from_code(driver).unwrap_or(Driver::Brake);
            let reason = Reason::from_code(reason).map_or("unknown", Reason::word);
            (driver, reason, count)
        })
    }
}
