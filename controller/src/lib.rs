//! Plan, policy and verdict to command, by the deadline.
//!
//! [`Controller::tick`] is the hot path, on one screen: admit, propose twice,
//! judge, choose, clamp, record. It always answers, and it neither allocates,
//! locks, logs nor reads a clock. `main.rs` gives it messages and the time.

mod choose;
mod pd;
mod policy;
mod slots;
mod tick;

pub use choose::{Choice, Intent, Standing, choose};
pub use pd::Pd;
pub use policy::{Policy, PolicySlot};
pub use slots::{Slot, Slots};
pub use tick::{Controller, Inputs};
