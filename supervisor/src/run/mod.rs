//! run

pub mod folder;
pub mod journal;
pub mod place;
pub mod restarts;
pub mod roster;
pub mod shared_memory;
pub mod target;
