//! Plan, policy and verdict to command, by the deadline.
//!
//! [`Controller::tick`] decides: admit, propose twice, judge, choose, clamp, record. It
//! always answers, and it neither allocates, locks, logs nor reads a clock. The tick of
//! the process around it (feature `process`) reads its messages and the time, and sends.
//!
//! New weights are checked, built and warmed by the `Loader` in a thread of its own,
//! pass through a single-slot [`Mailbox`], and run as a canary between two ticks
//! ([`Controller::run_canary`]).
//!
//! Without the feature `std` (and with `libm`), the tick needs neither the standard
//! library nor an allocator: it is the [`Arbiter`], to which the policy's answer is an
//! argument. What loads, swaps and rolls back policies needs `std`.
//!
//! ```
//! use controller::{Controller, Inputs, Intent, PolicySlot};
//! use shm_config::Instant;
//! use shm_config::config::Config;
//! use shm_config::message::Driver;
//!
//! let mut controller = Controller::new(Config::default(), PolicySlot::new(None));
//! // No observation has come: the car brakes.
//! let step = controller.tick(&Inputs::default(), 0, Instant(0), Intent::Drive);
//! assert_eq!(step.command.driver(), Driver::Brake);
//! ```

#![cfg_attr(not(feature = "std"), no_std)]

#[cfg(feature = "std")]
mod between_ticks;
mod choose;
#[cfg(feature = "std")]
mod controller;
mod pd;
#[cfg(feature = "std")]
mod policy;
#[cfg(feature = "process")]
pub mod ports;
#[cfg(feature = "process")]
mod process;
#[cfg(feature = "std")]
mod recompute;
mod tick;
mod transfer;

pub use choose::{ArbitrationInput, Choice, choose};
#[cfg(feature = "std")]
pub use controller::Controller;
pub use pd::Pd;
#[cfg(feature = "process")]
pub use policy::Loader;
#[cfg(feature = "std")]
pub use policy::{
    CanaryOutcome, Candidate, Exchanged, Fault, Mailbox, NativePolicy, OrtPolicy, OrtSession,
    Policy, PolicySlot, StartStage, SwapEvent, Terms, TickEnd, ask, build, library,
};
#[cfg(feature = "process")]
pub use process::{ControllerProcess, run};
#[cfg(feature = "std")]
pub use recompute::Recomputer;
pub use shm_config::message::{Intent, Stage};
pub use tick::{AdmittedAt, Arbiter, ArbiterConfig, Inputs, PolicyAnswer};
pub use transfer::Transfer;
