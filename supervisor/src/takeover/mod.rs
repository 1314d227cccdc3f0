//! takeover

pub mod driver;
pub mod keyboard;
pub mod script;
pub mod seat;
