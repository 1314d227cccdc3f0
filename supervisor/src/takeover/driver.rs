//! What a person at the keys wants of the car. Terminals tell when a key goes
//! down, again and again while it is held, and never when it comes up: a key
//! counts as held for a while after each time.

use shm_config::Instant;
use shm_config::message::Takeover;

use crate::takeover::axis::{Axis, BRAKE, GAS, STEERING, Side};
use crate::takeover::key::Key;

/// Keys in, what the car shall do out.
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
    /// A key went down, or was repeated. Only who has taken over steers.
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

    /// Time passes: what is held moves on, the rest springs back.
    pub fn advance(&mut self, now: Instant) {
        if now <= self.advanced {
            return;
        }
        self.steer.advance(self.advanced, now);
        self.pedal.advance(self.advanced, now);
        self.advanced = now;
    }

    /// The person drives.
    pub fn has_taken_over(&self) -> bool {
        self.has_taken_over
    }

    /// What the person wants now; its header is the publisher's to fill.
    pub fn takeover(&self) -> Takeover {
        Takeover {
            steer: self.steer.value,
            pedal: self.pedal.value,
            active: u32::from(self.has_taken_over),
            ..Takeover::default()
        }
    }
}
