use vehicle::Action;

use super::{Header, Message, Refusal, header_accessors, known, within};

crate::message! {
    /// The action of a human driver at the keys. It is published repeatedly, and an old
    /// message counts as none.
    #[derive(Default)]
    pub struct Takeover: 56 bytes, nested [Header] {
        /// The newest tick that the supervisor has read; taken when the keys were read.
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
    /// The person's action; `None` when no person has taken over.
    pub fn action(&self) -> Option<Action> {
        (self.active == 1).then_some(Action {
            steer: self.steer,
            pedal: self.pedal,
        })
    }
}
