//! A judge that costs nothing: a small net that has learned from recorded answers.
//!
//! [`features`] turns a question into numbers, the same in training and in driving; a
//! [`DistilledNet`] gives an [`Opinion`] of them and says whether it is sure. The tool
//! `./vlaps judge distil` trains the net and writes its file ([`mod@file`]); the gate asks
//! it before any slow judge (`crate::judge::Distilled`). Arithmetic only: no clock, no
//! thread.

pub mod features;
pub mod file;
mod net;
mod rollout;

pub use features::{INPUTS, Side, party_features};
pub use file::{About, FileError, KIND, MEMBERS_MAX, Range, assemble, decode, encode, read};
pub use net::{DistilledNet, OUTPUTS, Opinion, probabilities};
