//! Policy files: what they are, whether they may be trusted, and the runtime
//! that answers in the tick.
//!
//! A policy file is an ONNX file of at most 8 MB with one input of 259 floats,
//! the features of `Observation::features`, or of 379, with `Step::motion` behind them,
//! and one output of two, steering and pedal, each within [-1, 1] (the controller clamps
//! values beyond). It may use the operators of [`OPERATORS`] and no others. Eight metadata keys say where it comes
//! from and how it must answer:
//!
//! | key | value |
//! |---|---|
//! | `vlaps.format` | [`FORMAT_VERSION`] |
//! | `vlaps.observation_layout` | `shm_config::message::OBSERVATION_LAYOUT`, or `MOTION_LAYOUT` for 379 inputs, 16 hex digits |
//! | `vlaps.algorithm` `vlaps.seed` `vlaps.steps` `vlaps.commit` | [`Provenance`] |
//! | `vlaps.probe_inputs` | rows of as many numbers as it has inputs: `,` between numbers, `;` between rows |
//! | `vlaps.probe_outputs` | a row of two numbers for each |
//!
//! A file without any of them is a plain ONNX file, such as PyTorch's exporters write.
//! Its feature layout cannot be checked.
//!
//! [`decode`] makes every check and gives a [`Net`]: a chain of layers, with or without
//! convolutions over the scan before it, runs in the native runtime [`Mlp`], anything else needs ONNX Runtime. Arithmetic
//! only: no clock, no files, no threads.
//!
//! Without the feature `std` (and with `libm`), the native runtime needs neither the
//! standard library nor an allocator: [`Forward`] over weights of the caller's.
//!
//! ```
//! use policy::{Activation, Layer, Mlp, Net, Provenance, decode, encode};
//! use shm_config::message::FEATURES;
//!
//! let layer = Layer {
//!     weights: vec![0.0; 2 * FEATURES],
//!     bias: vec![0.0, 1.0],
//!     inputs: FEATURES,
//!     outputs: 2,
//!     activation: Activation::Tanh,
//! };
//! let file = encode(&Mlp::new(vec![layer])?, &Provenance::default(), &[]);
//! let Net::Mlp { mut mlp, .. } = decode(&file)?.net else { panic!("a chain of layers") };
//! assert_eq!(mlp.infer(&[0.5; FEATURES]), [0.0, 1f32.tanh()]);
//! # Ok::<(), policy::Refusal>(())
//! ```

#![cfg_attr(not(feature = "std"), no_std)]

#[cfg(feature = "std")]
mod chain;
#[cfg(feature = "std")]
mod chain_file;
#[cfg(feature = "std")]
mod constants;
#[cfg(feature = "std")]
pub mod drawn;
#[cfg(feature = "std")]
mod file;
mod forward;
#[cfg(feature = "std")]
mod graph;
#[cfg(feature = "std")]
mod metadata;
#[cfg(feature = "std")]
mod mlp;
#[cfg(feature = "std")]
mod onnx;
#[cfg(feature = "std")]
mod refusal;
#[cfg(feature = "std")]
mod scan;
#[cfg(feature = "std")]
mod windows;
#[cfg(feature = "std")]
mod windows_graph;

#[cfg(feature = "std")]
pub use chain::{Chain, Shape};
#[cfg(feature = "std")]
pub use chain_file::{ChainFile, decode_chain, encode_chain};
#[cfg(feature = "std")]
pub use file::{
    Names, Net, PolicyFile, TOLERANCE, check_answers, check_hash, decode, decode_within, encode,
    sha256, short_hash,
};
pub use forward::{
    ACTIONS, Activation, BLOCK, Compression, Forward, LAYERS_MAX, Mismatch, PackedLayer, pack,
};
#[cfg(feature = "std")]
pub use graph::OPERATORS;
#[cfg(feature = "std")]
pub use metadata::{FORMAT_VERSION, PROBES_MAX, Probe, Provenance};
#[cfg(feature = "std")]
pub use mlp::{Layer, Mlp, WIDTH_MAX};
#[cfg(feature = "std")]
pub use refusal::Refusal;
#[cfg(feature = "std")]
pub use windows::Windows;
