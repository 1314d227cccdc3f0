//! commands

pub mod clean;
pub mod config;
pub mod delegate;
pub mod doctor;
pub mod down;
pub mod status;
pub mod swap;
pub mod up;
