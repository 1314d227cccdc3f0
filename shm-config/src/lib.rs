//! The wire: messages, service table, age limits, time, configuration.
//!
//! The only crate that names iceoryx2. Everything that two processes must agree
//! on stands here and nowhere else.

pub mod layout;
pub mod message;
pub mod time;

pub use message::Message;
pub use time::Instant;
