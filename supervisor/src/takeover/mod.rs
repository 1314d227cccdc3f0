//! Takeovers by a human driver: keys of a terminal or a file become takeover messages.

pub mod axis;
pub mod driver;
pub mod input;
pub mod key;
pub mod keyboard;
pub mod script;
