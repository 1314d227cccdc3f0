//! The commands: each has its arguments and its run in one file or folder.

pub mod clean;
pub mod cluster;
pub mod config;
pub mod conform;
pub mod delegate;
pub mod doctor;
pub mod down;
pub mod link;
pub mod setup;
pub mod status;
pub mod swap;
pub mod up;
