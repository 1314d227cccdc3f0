//! Steering and pedal, moved by keys.

use shm_config::Instant;

/// How long a key counts as held after it was pressed, ns: the repeat delay of most
/// terminals. With less, the wheel would return to the centre once during each long
/// press.
const PRESSED_NS: u64 = 500_000_000;
/// How long a key counts as held after a repetition, ns: repetitions come every 30 to
/// 40 ms, are read every 50, and one of them may be late.
const REPEATED_NS: u64 = 150_000_000;
const _: () = assert!(REPEATED_NS < PRESSED_NS);

/// The rate of an axis while a key is held, and of its return, 1/s.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rates {
    out: f64,
    back: f64,
}

// The rates of MetaDrive's keyboard (manual_controller.py), whose increments are per
// step of 0.1 s: its demonstrations were driven with them.

/// Full lock after 2.5 s: a short press turns the car by some degrees.
pub(super) const STEERING: Rates = Rates {
    out: 0.4,
    back: 2.5,
};
/// Full gas after a second.
pub(super) const GAS: Rates = Rates {
    out: 1.0,
    back: 2.0,
};
/// Full brake after 0.2 s.
pub(super) const BRAKE: Rates = Rates {
    out: 5.0,
    back: 5.0,
};

/// The direction in which a key moves an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Positive,
    Negative,
}

/// Steering or pedal, [-1, 1].
#[derive(Debug, Clone, Copy)]
pub(super) struct Axis {
    pub(super) value: f64,
    positive: Rates,
    negative: Rates,
    held: Option<(Side, Instant)>,
}

impl Axis {
    pub(super) fn new(positive: Rates, negative: Rates) -> Self {
        Self {
            value: 0.0,
            positive,
            negative,
            held: None,
        }
    }

    pub(super) fn press(&mut self, side: Side, now: Instant) {
        self.held = Some(match self.held {
            Some((held, until)) if held == side => (side, until.max(now.after_ns(REPEATED_NS))),
            _ => (side, now.after_ns(PRESSED_NS)),
        });
    }

    pub(super) fn advance(&mut self, from: Instant, to: Instant) {
        let released = match self.held {
            Some((side, until)) => {
                let released = until.clamp(from, to);
                self.pull(side, seconds(from, released));
                if until <= to {
                    self.held = None;
                }
                released
            }
            None => from,
        };
        let back = self.rates(self.value).back * seconds(released, to);
        self.value = towards(self.value, 0.0, back);
    }

    /// Moves back from the other side first, then outwards.
    fn pull(&mut self, side: Side, mut time_s: f64) {
        let end = match side {
            Side::Positive => 1.0,
            Side::Negative => -1.0,
        };
        let out = self.rates(end).out;
        if self.value * end < 0.0 {
            let rate = out.max(self.rates(self.value).back);
            let needed_s = self.value.abs() / rate;
            self.value = towards(self.value, 0.0, rate * time_s);
            time_s = (time_s - needed_s).max(0.0);
        }
        self.value = towards(self.value, end, out * time_s);
    }

    fn rates(&self, value: f64) -> Rates {
        match value < 0.0 {
            true => self.negative,
            false => self.positive,
        }
    }
}

fn seconds(from: Instant, to: Instant) -> f64 {
    to.since_ns(from) as f64 * 1e-9
}

/// `value` moved towards `end` by no more than `step`.
fn towards(value: f64, end: f64, step: f64) -> f64 {
    match value < end {
        true => (value + step).min(end),
        false => (value - step).max(end),
    }
}
