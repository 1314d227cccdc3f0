//! The place of a run on the machine: lock, folder, shared memory, roster, journal.

pub mod folder;
pub mod journal;
pub mod leftovers;
pub mod place;
pub mod restarts;
pub mod roster;
pub mod selection;
pub mod shared_memory;
pub mod target;
