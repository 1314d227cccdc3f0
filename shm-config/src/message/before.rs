//! The state with which a tick begins, as a step records it.

use super::{Driver, Refusal, known};
use crate::settings::Late;

crate::word_list! {
    /// What the process asks of the tick.
    pub enum Intent {
        /// Drive.
        Drive = 0 "drive",
        /// Bring the car to rest.
        Stop = 1 "stop",
        /// Brake: two processes send one state, so neither can be trusted.
        Contested = 2 "contested",
    }
}

crate::word_list! {
    /// The state of the policy before it may drive.
    pub enum Stage {
        /// No policy is loaded.
        Unloaded = 0 "unloaded",
        /// The only policy proposes in shadow mode.
        Shadow = 1 "shadow",
        /// A policy may drive.
        Active = 2 "active",
    }
}

crate::word_list! {
    /// The result of the check of one input.
    pub enum Admission {
        /// No message arrived since the last tick; the last admitted one is used.
        Absent = 0 "absent",
        /// A message arrived and was admitted.
        Admitted = 1 "admitted",
        /// A message arrived and was refused; the last admitted one is used.
        Refused = 2 "refused",
    }
}

crate::word_list! {
    /// The lateness of a command or plan, and what followed.
    pub enum Lateness {
        /// Decided by the deadline.
        OnTime = 0 "on time",
        /// Decided late, and sent as decided.
        Counted = 1 "counted",
        /// Decided late, and not sent.
        HeldBack = 2 "held back",
        /// Decided late, and replaced by the brake.
        Braked = 3 "braked",
    }
}

crate::message! {
    /// The check of one input of a tick.
    #[derive(Default)]
    pub struct Entry: 16 bytes {
        /// The clock at which the port admitted the message, ns on the run's clock; 0
        /// when none arrived.
        pub port_ns: u64,
        /// An [`Admission`]: the tick's own check, at the instant in the step's header.
        pub admission: u32,
        /// Not used.
        pub reserved: u32,
    }
}

crate::message! {
    /// The errors from which the PD controller computes its differences.
    #[derive(Default)]
    pub struct PdState: 48 bytes {
        /// Heading to the lookahead waypoint, rad.
        pub heading_rad: f64,
        /// Desired speed minus the car's, m/s.
        pub speed_mps: f64,
        /// The goal that is tracked, world frame, x, m.
        pub goal_x_world_m: f64,
        /// The goal that is tracked, world frame, y, m.
        pub goal_y_world_m: f64,
        /// When the observation of the errors was taken, ns.
        pub taken_ns: u64,
        /// Its episode.
        pub episode: u32,
        /// 1 when there are errors, else 0.
        pub present: u32,
    }
}

crate::message! {
    /// The command from which a hand-over starts.
    #[derive(Default)]
    pub struct TransferState: 32 bytes {
        /// Steering, normalised.
        pub steer: f64,
        /// Pedal, normalised.
        pub pedal: f64,
        /// A [`Driver`].
        pub driver: u32,
        /// The episode of that command.
        pub episode: u32,
        /// 1 when there is a command, else 0.
        pub present: u32,
        /// 1 while the command moves towards the new driver's, else 0.
        pub is_easing: u32,
    }
}

crate::message! {
    /// The state of the controller before a tick, beside the messages that it holds.
    #[derive(Default)]
    pub struct Before: 104 bytes, nested [PdState, TransferState] {
        /// The state of the PD controller.
        pub pd: PdState,
        /// The state of the hand-over.
        pub transfer: TransferState,
        /// Messages refused since the controller started.
        pub refused: u64,
        /// 1 when an observation was admitted since then, else 0.
        pub has_observation: u32,
        /// 1 when a plan was admitted since then, else 0.
        pub has_plan: u32,
        /// 1 when advice was admitted since then, else 0.
        pub has_advice: u32,
        /// Not used.
        pub reserved: u32,
    }
}

impl Lateness {
    /// What follows from a late answer with this setting.
    pub fn of(policy: Late) -> Self {
        match policy {
            Late::Count => Self::Counted,
            Late::Skip => Self::HeldBack,
            Late::Brake => Self::Braked,
        }
    }
}

impl Entry {
    /// The result of the check; an unknown code is read as a refusal.
    pub fn admission(&self) -> Admission {
        Admission::from_code(self.admission).unwrap_or(Admission::Refused)
    }

    pub(super) fn check(&self, field: &'static str) -> Result<(), Refusal> {
        known(field, self.admission, Admission::from_code)
    }
}

impl Before {
    pub(super) fn check(&self) -> Result<(), Refusal> {
        let (pd, transfer) = (&self.pd, &self.transfer);
        for (field, value) in [
            ("before.pd.heading_rad", pd.heading_rad),
            ("before.pd.speed_mps", pd.speed_mps),
            ("before.pd.goal_x_world_m", pd.goal_x_world_m),
            ("before.pd.goal_y_world_m", pd.goal_y_world_m),
        ] {
            if !value.is_finite() {
                return Err(Refusal::NotFinite { field });
            }
        }
        super::within("before.transfer.steer", transfer.steer, -1.0..=1.0)?;
        super::within("before.transfer.pedal", transfer.pedal, -1.0..=1.0)?;
        known("before.transfer.driver", transfer.driver, Driver::from_code)?;
        for (field, code) in [
            ("before.pd.present", pd.present),
            ("before.transfer.present", transfer.present),
            ("before.transfer.is_easing", transfer.is_easing),
            ("before.has_observation", self.has_observation),
            ("before.has_plan", self.has_plan),
            ("before.has_advice", self.has_advice),
        ] {
            known(field, code, |code| (code <= 1).then_some(code))?;
        }
        Ok(())
    }
}
