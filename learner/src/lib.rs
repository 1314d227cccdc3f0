//! From steps to weights: the learner makes better policies from recorded steps.
//!
//! | module | holds |
//! |---|---|
//! | [`assembler`] | steps to transitions, with the label of their question |
//! | [`replay`], [`journal`] | the replay buffers, in memory and on disk |
//! | [`algorithm`] | the learning algorithms, one file each |
//! | [`network`], [`input`], [`adam`], [`matrix`], [`share`] | perceptrons, their input, their gradients, their optimiser, the threads |
//! | [`features`], [`export`] | the networks' input; the export of a network as a
//! policy file |
//! | [`elsewhere`], [`imagine`] | observations and the expert's actions at states that
//! were never visited |
//! | [`relearn`], [`unchanged`] | a policy from the replay of sessions, trained anew; one that
//! drives while they record |
//! | [`session`], [`checkpoint`], [`metrics`] | the learning session, which is on disk
//! after every block |
//!
//! The feature `process` (default) adds the process: the loop that reads and publishes.
//!
//! ```
//! use learner::adam::Adam;
//! use learner::network::{Head, Network, Tape};
//! use rand_xoshiro::Xoshiro256PlusPlus;
//! use rand_xoshiro::rand_core::SeedableRng;
//!
//! let mut random = Xoshiro256PlusPlus::seed_from_u64(0);
//! let actor = Network::new(&[4, 8, 2], Head::Tanh, &mut random);
//! let mut tape = Tape::default();
//! // Two rows of four inputs; two actions of two numbers.
//! let actions = actor.forward(&[0.5; 8], 1, &mut tape);
//! assert_eq!(actions.len(), 4);
//! ```

pub mod adam;
pub mod algorithm;
pub mod assembler;
pub mod checkpoint;
pub mod elsewhere;
pub mod export;
pub mod features;
pub mod imagine;
pub mod input;
pub mod journal;
pub mod matrix;
pub mod metrics;
pub mod network;
#[cfg(feature = "process")]
pub mod ports;
#[cfg(feature = "process")]
mod process;
pub mod relearn;
pub mod replay;
pub mod session;
pub mod share;
pub mod unchanged;
pub mod windows;

pub use adam::{Adam, Rate};
pub use network::{Network, Tape};
#[cfg(feature = "process")]
pub use process::run;
