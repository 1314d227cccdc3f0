//! The action of a human driver at the keys. A terminal reports a key when it goes down
//! and repeatedly while it is held, but not when it is released: a key counts as held for
//! a fixed time after each report.

use shm_config::Instant;
use shm_config::message::Takeover;

use crate::takeover::axis::{Axis, BRAKE, GAS, STEERING, Side};
use crate::takeover::key::Key;

/// Turns keys into a takeover action.
#[derive(Debug, Clone)]
pub struct HumanDriver {
    has_taken_over: bool,
    steer: Axis,
    pedal: Axis,
    advanced: Instant,
}

impl Default for HumanDriver {
    fn default() -> Self {
        Self {
            has_taken_over: false,
            steer: Axis::new(STEERING, STEERING),
            pedal: Axis::new(GAS, BRAKE),
            advanced: Instant(0),
        }
    }
}

impl HumanDriver {
    /// A key went down, or was repeated. Steering and pedal keys have no effect before a
    /// takeover.
    pub fn press(&mut self, key: Key, now: Instant) {
        self.advance(now);
        match (key, self.has_taken_over) {
            (Key::Switch, false) => {
                self.has_taken_over = true;
            }
            (Key::Switch | Key::GiveBack, _) => {
                *self = Self {
                    advanced: self.advanced,
                    ..Self::default()
                };
            }
            (_, false) => {}
            (Key::Left, true) => self.steer.press(Side::Positive, now),
            (Key::Right, true) => self.steer.press(Side::Negative, now),
            (Key::Gas, true) => self.pedal.press(Side::Positive, now),
            (Key::Brake, true) => self.pedal.press(Side::Negative, now),
        }
    }

    /// Advances the axes to `now`: held ones move on, the others return to zero.
    pub fn advance(&mut self, now: Instant) {
        if now <= self.advanced {
            return;
        }
        self.steer.advance(self.advanced, now);
        self.pedal.advance(self.advanced, now);
        self.advanced = now;
    }

    /// Whether the human driver has taken over.
    pub fn has_taken_over(&self) -> bool {
        self.has_taken_over
    }

    /// The takeover action now; the publisher fills its header.
    pub fn takeover(&self) -> Takeover {
        Takeover {
            steer: self.steer.value,
            pedal: self.pedal.value,
            active: u32::from(self.has_taken_over),
            ..Takeover::default()
        }
    }
}
