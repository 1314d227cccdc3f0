//! The wire: messages, service table, age limits, time, configuration.
//!
//! The only crate that names iceoryx2. Everything that two processes must agree
//! on stands here and nowhere else.

pub mod config;
pub mod histogram;
pub mod layout;
pub mod message;
pub mod run;
pub mod services;
pub mod time;
pub mod wire;

pub use message::Message;
pub use time::Instant;
