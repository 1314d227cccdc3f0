//! Steps to weights: what the car lived through becomes a better driver.

pub mod adam;
pub mod algorithm;
pub mod assembler;
pub mod checkpoint;
pub mod elsewhere;
pub mod export;
pub mod features;
pub mod imagine;
pub mod journal;
mod matrix;
pub mod network;
pub mod oracle;
pub mod replay;

pub use adam::Adam;
pub use network::{Network, Tape};
