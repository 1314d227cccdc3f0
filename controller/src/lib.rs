//! Plan, policy and verdict to command, by the deadline.
//!
//! [`Controller::tick`] decides: admit, propose twice, judge, choose, clamp, record. It
//! always answers, and it neither allocates, locks, logs nor reads a clock. The tick of
//! the process around it (feature `process`) reads its messages and the time, and sends.
//!
//! New weights are checked, built and warmed by the `Loader` in a thread of its own,
//! pass through a single-slot [`Mailbox`], and run as a canary between two ticks
//! ([`Controller::run_canary`]).

mod between_ticks;
mod choose;
mod controller;
mod pd;
mod policy;
#[cfg(feature = "process")]
pub mod ports;
#[cfg(feature = "process")]
mod process;
mod recompute;
mod tick;
mod transfer;

pub use choose::{ArbitrationInput, Choice, choose};
pub use controller::Controller;
pub use pd::Pd;
#[cfg(feature = "process")]
pub use policy::Loader;
pub use policy::{
    CanaryOutcome, Candidate, Exchanged, Fault, Mailbox, NativePolicy, OrtPolicy, OrtSession,
    Policy, PolicySlot, StartStage, SwapEvent, Terms, TickEnd, build, library,
};
#[cfg(feature = "process")]
pub use process::{ControllerProcess, run};
pub use recompute::Recomputer;
pub use shm_config::message::{Intent, Stage};
pub use tick::{AdmittedAt, Arbiter, ArbiterConfig, Inputs, PolicyAnswer};
pub use transfer::Transfer;
