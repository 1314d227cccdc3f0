//! A vision-language model as judge.
//!
//! A [`gate::Question`] becomes pictures (the frame of its tick with both
//! rollouts drawn in), prompts, and HTTP requests; what comes back becomes an
//! answer or a counted fault, never a guess. How the two proposals are shown is
//! decided once, in a [`Showing`]: the picture is drawn and the prompt is worded
//! from the same value, so they cannot disagree. Everything asked is kept as a
//! [`record::Record`] by a [`store::Store`], to be audited and asked again.
//!
//! [`standin`] is a server for tests and offline work that speaks the same
//! protocol. It is no model.

mod answer;
mod archive;
pub mod audit;
mod bench;
mod breaker;
mod clerk;
mod client;
mod connection;
mod cost;
mod dialect;
pub mod eyes;
mod fault;
mod json;
mod key;
mod limits;
mod model;
pub mod picture;
pub mod ports;
mod prompt;
pub mod record;
mod recorded;
pub mod replay;
mod retry;
mod showing;
pub mod standin;
pub mod statistics;
pub mod store;
mod tally;
mod transport;

pub use answer::{Reading, read as read_answer};
pub use archive::Archive;
pub use bench::{Bench, BenchError, as_the_paper};
pub use clerk::{Clerk, Evidence, Filed};
pub use client::{Asked, Asker, AskerError, SAID_BYTES_MAX};
pub use cost::Estimate;
pub use dialect::body;
pub use fault::Fault;
pub use key::KeyError;
pub use model::model;
pub use picture::Picture;
pub use prompt::{LETTERS, Prompt, SIMILAR, fixed_showing};
pub use recorded::Recorded;
pub use showing::{Hue, Party, Reply, Showing, combine};
