//! The wire: messages, service table, age limits, time, configuration.
//!
//! The only crate that names iceoryx2. Everything that two processes must agree
//! on stands here and nowhere else.
//!
//! The feature `wire` (default) adds what needs iceoryx2 or Linux: ports, runs, files,
//! secrets and the machine's clock. Messages, services and configuration need neither.

pub mod config;
mod counted;
pub mod difference;
#[cfg(feature = "wire")]
pub mod file;
mod grid;
pub mod histogram;
pub mod judged;
pub mod layout;
pub mod message;
pub mod palette;
#[cfg(feature = "wire")]
pub mod python;
#[cfg(feature = "wire")]
pub mod run;
#[cfg(feature = "wire")]
pub mod secret;
pub mod services;
mod shortened;
pub mod text;
pub mod time;
pub mod turns;
#[cfg(feature = "wire")]
#[allow(clippy::disallowed_types)] // the one place that may name iceoryx2
pub mod wire;

pub use counted::counted;
pub use grid::RunGrid;
pub use message::Message;
pub use shortened::shortened;
pub use time::Instant;
pub use turns::PlanTurns;
