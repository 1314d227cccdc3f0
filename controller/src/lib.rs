//! Plan, policy and verdict to command, by the deadline.
//!
//! [`Controller::tick`] is the hot path, on one screen: admit, propose twice,
//! judge, choose, clamp, record. It always answers, and it neither allocates,
//! locks, logs nor reads a clock. `main.rs` gives it messages and the time.
//!
//! New weights are checked, built and warmed by the [`Loader`] in a thread of its
//! own, change hands over an [`Exchange`], and are tried and turned between two
//! ticks ([`Controller::try_policies`]).

mod between;
mod choose;
mod controller;
mod pd;
mod policy;
pub mod ports;
mod recompute;
mod slots;
mod tick;
mod transfer;

pub use choose::{Choice, Standing, choose};
pub use controller::Controller;
pub use pd::Pd;
pub use policy::{
    Begin, Exchange, Fault, Hand, Loader, Look, NativePolicy, News, Offer, OrtPolicy, OrtSession,
    Policy, PolicySlot, Terms, Turn, build, library,
};
pub use recompute::Recomputer;
pub use shm_config::message::{Intent, Stage};
pub use slots::{Release, Slot, Slots};
pub use tick::{AdmittedAt, Arbiter, ArbiterConfig, Inputs, PolicyAnswer};
pub use transfer::Transfer;
