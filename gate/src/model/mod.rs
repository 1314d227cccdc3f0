//! The client of a model: one question over HTTP, within the run's limits.

mod answer;
mod body;
mod breaker;
mod client;
mod connection;
mod cost;
mod fault;
mod json;
mod key;
mod limits;
mod retry;
mod transport;

pub use answer::{Reading, read as read_answer};
pub use body::body;
pub use client::{Asked, Asker, SAID_BYTES_MAX};
pub use connection::AskerError;
pub use cost::Estimate;
pub use fault::Fault;
pub use key::KeyError;
pub use limits::Rate;
