//! Steps to weights: what was driven becomes a better driver.
//!
//! | module | holds |
//! |---|---|
//! | [`assembler`] | steps to transitions, with the label of their question |
//! | [`replay`], [`journal`] | the replay buffers, in memory and on disk |
//! | [`algorithm`] | the ways to learn, a file each |
//! | [`network`], [`adam`], [`matrix`], [`share`] | perceptrons, their gradients, their optimiser, the threads |
//! | [`features`], [`export`] | the networks' input; a network becomes a policy file |
//! | [`elsewhere`], [`imagine`] | what would be seen, and what the expert would do, off the driven path |
//! | [`session`], [`checkpoint`], [`metrics`] | a learner's life, on disk after every block |
//!
//! The feature `process` (default) adds the process: the loop between the ports.

pub mod adam;
pub mod algorithm;
pub mod assembler;
pub mod checkpoint;
pub mod elsewhere;
pub mod export;
pub mod features;
pub mod imagine;
pub mod journal;
pub mod matrix;
pub mod metrics;
pub mod network;
#[cfg(feature = "process")]
pub mod ports;
#[cfg(feature = "process")]
mod process;
pub mod replay;
pub mod session;
pub mod share;

pub use adam::Adam;
pub use network::{Network, Tape};
#[cfg(feature = "process")]
pub use process::run;
