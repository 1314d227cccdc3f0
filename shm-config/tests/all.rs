//! The integration tests of this crate, in one program, since each program links all
//! libraries again. `cargo test -p shm-config --test all NAME::` runs those of one file.

mod camera;
mod config;
mod door;
mod features;
mod file;
mod python;
mod services;
mod vehicle;
