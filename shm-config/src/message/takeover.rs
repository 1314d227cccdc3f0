use vehicle::Action;

use super::{Header, Message, Refusal, header_accessors, known, within};

crate::message! {
    /// What a person at the keys wants; said again and again, since an old word
    /// counts as none.
    #[derive(Default)]
    pub struct Takeover: 56 bytes, nested [Header] {
        /// The newest tick the supervisor heard of; taken when the keys were read.
        pub header: Header,
        /// Steering, normalised, [-1, 1], positive left.
        pub steer: f64,
        /// Pedal, normalised, [-1, 1], negative brakes.
        pub pedal: f64,
        /// 1 while the person has taken over, else 0.
        pub active: u32,
        /// Not used.
        pub reserved: u32,
    }
}

impl Message for Takeover {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        within("steer", self.steer, -1.0..=1.0)?;
        within("pedal", self.pedal, -1.0..=1.0)?;
        known("active", self.active, |code| (code <= 1).then_some(code))
    }
}

impl Takeover {
    /// What the person does with the car; `None` without a takeover.
    pub fn action(&self) -> Option<Action> {
        (self.active == 1).then_some(Action {
            steer: self.steer,
            pedal: self.pedal,
        })
    }
}
