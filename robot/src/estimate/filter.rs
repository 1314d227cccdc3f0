use std::collections::VecDeque;

use shm_config::Instant;

use super::belief::{Belief, Verdict};
use super::{Estimate, EstimateError, Measurement, Noise, Settings, Start};

/// Most measurements within [`Settings::delay_s`]: IMU and wheels at 200 Hz each and scans at
/// 20 Hz with their keyframes for one second, rounded up. Each takes 1.2 kB.
pub const HISTORY: usize = 512;

/// What became of the measurements so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Applied.
    pub applied: u64,
    /// Rejected by their gate.
    pub rejected: u64,
    /// Refused because they were older than the filter accepts.
    pub late: u64,
    /// Refused for any other reason.
    pub refused: u64,
}

/// A measurement with the belief after it.
#[derive(Clone, Copy)]
struct Event {
    taken: Instant,
    measurement: Measurement,
    belief: Belief,
    verdict: Verdict,
}

impl Event {
    fn order(&self) -> (Instant, usize) {
        (self.taken, self.measurement.kind())
    }
}

/// An extended Kalman filter. Measurements may arrive in any order within
/// [`Settings::delay_s`]: each is applied at its own instant, and those after it again. The
/// estimate is then the one of their order in time, to the last bit.
///
/// Nothing allocates after [`Filter::new`]; a measurement that is late by all of the
/// history costs one update for each measurement in it.
pub struct Filter {
    settings: Settings,
    noise: Noise,
    delay_ns: u64,
    newest: Instant,
    /// The belief before the history.
    base: Belief,
    /// Ordered by time and kind.
    history: VecDeque<Event>,
    counts: Counts,
}

impl Filter {
    /// A filter that knows what `start` says.
    ///
    /// # Errors
    /// [`EstimateError::Setting`]: a number is not finite or out of range.
    pub fn new(settings: &Settings, noise: &Noise, start: &Start) -> Result<Self, EstimateError> {
        settings.check()?;
        noise.check()?;
        start.check()?;
        Ok(Self {
            settings: *settings,
            noise: *noise,
            delay_ns: (settings.delay_s * 1e9) as u64,
            newest: start.at,
            base: Belief::new(start),
            history: VecDeque::with_capacity(HISTORY),
            counts: Counts::default(),
        })
    }

    /// Takes a measurement that arrived at `now` and was taken at `taken`. `now` never goes
    /// back from call to call. Returns what the measurement did at its own instant; one that
    /// its gate rejects stays in the history, and is judged again when an earlier one
    /// arrives.
    ///
    /// # Errors
    /// The measurement is not finite, out of range, of the future, older than the filter
    /// accepts, there already, or without its keyframe. The state has not changed then;
    /// of the last three kinds the clock has.
    pub fn add(
        &mut self,
        now: Instant,
        taken: Instant,
        measurement: Measurement,
    ) -> Result<Verdict, EstimateError> {
        let place = self.place(now, taken, &measurement);
        match place {
            Err(EstimateError::Late { .. }) => self.counts.late += 1,
            Err(_) => self.counts.refused += 1,
            Ok(_) => {}
        }
        let place = place?;
        let belief = *self.before(place);
        let verdict = Verdict {
            nis: 0.0,
            freedoms: 0,
            is_applied: false,
        };
        let event = Event {
            taken,
            measurement,
            belief,
            verdict,
        };
        self.history.insert(place, event);
        self.filter_from(place);
        Ok(self.history[place].verdict)
    }

    /// The estimate at an instant: of all measurements up to it, and predicted from the
    /// newest of them. Beyond `now` it is a forecast.
    ///
    /// # Errors
    /// [`EstimateError::Late`]: the instant is before the history.
    pub fn estimate(&self, at: Instant) -> Result<Estimate, EstimateError> {
        let oldest = self.base.at;
        if at < oldest {
            return Err(EstimateError::Late { taken: at, oldest });
        }
        let place = self.history.partition_point(|event| event.taken <= at);
        Ok(self.before(place).predicted(at, &self.noise).estimate())
    }

    /// What became of the measurements.
    pub fn counts(&self) -> Counts {
        let mut counts = self.counts;
        self.history.iter().for_each(|event| counts.count(event));
        counts
    }

    /// Where in the history a measurement belongs, once what is too old has left it.
    fn place(
        &mut self,
        now: Instant,
        taken: Instant,
        measurement: &Measurement,
    ) -> Result<usize, EstimateError> {
        if now < self.newest {
            let newest = self.newest;
            return Err(EstimateError::Clock { now, newest });
        }
        measurement.check()?;
        if taken > now {
            return Err(EstimateError::Future { taken, now });
        }
        // Only a measurement that is in order moves the clock: a refused one far ahead would
        // make all that follow it too late.
        self.newest = now;
        self.forget();
        // Before the first delay is over nothing is older than the start.
        let oldest = self
            .base
            .at
            .max(Instant(now.0.saturating_sub(self.delay_ns)));
        if taken < oldest {
            return Err(EstimateError::Late { taken, oldest });
        }
        let order = (taken, measurement.kind());
        let place = self.history.partition_point(|event| event.order() < order);
        if self
            .history
            .get(place)
            .is_some_and(|event| event.order() == order)
        {
            return Err(EstimateError::Duplicate { taken });
        }
        match measurement {
            Measurement::Motion { since, .. } if self.before(place).keyframe != Some(*since) => {
                return Err(EstimateError::Keyframe { since: *since });
            }
            // A motion after it begins at the keyframe before it.
            Measurement::Keyframe if self.history.range(place..).any(is_of_scan) => {
                return Err(EstimateError::OutOfOrder { taken });
            }
            _ => {}
        }
        match self.history.len() < HISTORY {
            true => Ok(place),
            false => Err(EstimateError::Full),
        }
    }

    /// Moves what is older than the delay from the history into the base.
    fn forget(&mut self) {
        let oldest = Instant(self.newest.0.saturating_sub(self.delay_ns));
        while let Some(event) = self.history.front().filter(|event| event.taken < oldest) {
            self.counts.count(event);
            self.base = event.belief;
            self.history.pop_front();
        }
    }

    /// The belief before a place of the history.
    fn before(&self, place: usize) -> &Belief {
        let event = place
            .checked_sub(1)
            .and_then(|place| self.history.get(place));
        event.map_or(&self.base, |event| &event.belief)
    }

    /// Applies the measurements from a place on again.
    fn filter_from(&mut self, place: usize) {
        let mut belief = *self.before(place);
        for event in self.history.range_mut(place..) {
            belief = belief.predicted(event.taken, &self.noise);
            event.verdict = belief.apply(&event.measurement, &self.noise, &self.settings);
            event.belief = belief;
        }
    }
}

impl Counts {
    fn count(&mut self, event: &Event) {
        match event.verdict {
            // A keyframe measures nothing.
            Verdict { freedoms: 0, .. } => {}
            Verdict {
                is_applied: true, ..
            } => self.applied += 1,
            Verdict { .. } => self.rejected += 1,
        }
    }
}

fn is_of_scan(event: &Event) -> bool {
    matches!(
        event.measurement,
        Measurement::Keyframe | Measurement::Motion { .. }
    )
}
