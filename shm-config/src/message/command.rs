use vehicle::Action;

use super::{Header, Message, Refusal, header_accessors, known, within};

crate::word_list! {
    /// Which driver drove.
    pub enum Driver {
        /// The hand-made expert.
        Expert = 0 "expert",
        /// The learned policy.
        Policy = 1 "policy",
        /// The brake, when neither may drive.
        Brake = 2 "brake",
    }
}

crate::word_list! {
    /// Why this driver drove: one word from a closed list.
    pub enum Reason {
        /// The configured gate always selects this driver.
        Configured = 0 "configured",
        /// Valid advice prefers this driver.
        Advised = 1 "advised",
        /// No advice was ever given: the expert drives.
        Unadvised = 2 "unadvised",
        /// The last advice has expired: the expert drives.
        Expired = 3 "expired",
        /// No policy is loaded: the expert drives.
        Unloaded = 4 "unloaded",
        /// The policy's answer was late or not finite: the expert drives.
        Faulty = 5 "faulty",
        /// The safety check vetoed the driver in charge.
        Vetoed = 6 "vetoed",
        /// The safety check vetoed all proposals: the brake.
        Unsafe = 7 "unsafe",
        /// The plan found no free step: the brake.
        Blocked = 8 "blocked",
        /// No plan young enough: the brake.
        Unplanned = 9 "unplanned",
        /// No observation young enough: the brake.
        Blind = 10 "blind",
        /// The run is being stopped: the brake.
        Stopping = 11 "stopping",
        /// A person has taken over from the expert.
        Takeover = 12 "takeover",
        /// The only policy still proposes in shadow mode: the expert drives.
        Shadow = 13 "shadow",
        /// The tick was done after its deadline (`deadlines.controller`): the brake, or
        /// the driver whose command was not sent.
        Late = 14 "late",
        /// A process that the run did not start sends in place of one that it did
        /// start: the brake.
        Contested = 15 "contested",
    }
}

crate::message! {
    /// The action of the car until the next command or the age limit.
    pub struct Command: 56 bytes, nested [Header] {
        /// The observation's tick; taken when the command was given.
        pub header: Header,
        /// Steering, normalised, [-1, 1], positive left.
        pub steer: f64,
        /// Pedal, normalised, [-1, 1], negative brakes.
        pub pedal: f64,
        /// A [`Driver`].
        pub driver: u32,
        /// A [`Reason`].
        pub reason: u32,
    }
}

impl Message for Command {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        within("steer", self.steer, -1.0..=1.0)?;
        within("pedal", self.pedal, -1.0..=1.0)?;
        known("driver", self.driver, Driver::from_code)?;
        known("reason", self.reason, Reason::from_code)
    }
}

impl Command {
    /// The normalised action.
    pub fn action(&self) -> Action {
        Action {
            steer: self.steer,
            pedal: self.pedal,
        }
    }

    /// Which driver drove; an unknown code is read as the brake.
    pub fn driver(&self) -> Driver {
        Driver::from_code(self.driver).unwrap_or(Driver::Brake)
    }

    /// The reason; `None` for an unknown code.
    pub fn reason(&self) -> Option<Reason> {
        Reason::from_code(self.reason)
    }

    /// The bits that make up the command digest of a run: both components,
    /// the driver and the reason, little endian.
    pub fn digest_bytes(&self) -> [u8; 24] {
        let mut bytes = [0; 24];
        bytes[..8].copy_from_slice(&self.steer.to_bits().to_le_bytes());
        bytes[8..16].copy_from_slice(&self.pedal.to_bits().to_le_bytes());
        bytes[16..20].copy_from_slice(&self.driver.to_le_bytes());
        bytes[20..].copy_from_slice(&self.reason.to_le_bytes());
        bytes
    }
}
