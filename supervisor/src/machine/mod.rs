//! The machine: cores, sleeping processors, memory and threads by /proc, signals, programs,
//! the service manager.

pub mod cores;
pub mod idle;
pub mod memory;
pub mod parent;
pub mod programs;
pub mod service;
pub mod signals;
pub mod threads;
