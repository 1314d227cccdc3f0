//! The wire: messages, service table, age limits, time, configuration.
//!
//! The only crate that names iceoryx2. Everything that two processes must agree
//! on stands here and nowhere else.

pub mod config;
mod counted;
pub mod difference;
pub mod file;
mod grid;
pub mod histogram;
pub mod judged;
pub mod layout;
pub mod message;
pub mod palette;
pub mod python;
pub mod run;
pub mod secret;
pub mod services;
mod shortened;
pub mod text;
pub mod time;
pub mod turns;
#[allow(clippy::disallowed_types)] // the one place that may name iceoryx2
pub mod wire;

pub use counted::counted;
pub use grid::RunGrid;
pub use message::Message;
pub use shortened::shortened;
pub use time::Instant;
pub use turns::PlanTurns;
