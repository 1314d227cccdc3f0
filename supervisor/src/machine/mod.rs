//! machine

pub mod cores;
pub mod idle;
pub mod memory;
pub mod parent;
pub mod signals;
pub mod threads;
