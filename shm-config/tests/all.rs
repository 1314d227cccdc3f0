//! The integration tests of this crate, one program: each program is linked anew.

mod camera;
mod config;
mod door;
mod features;
mod file;
mod python;
mod services;
mod vehicle;
