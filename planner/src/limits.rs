//! How much room there is. `PlannerConfig::check` keeps to these numbers (a test
//! in `tests/limits.rs` says so); beyond them a grid would inflate less and a
//! tree would stop growing, never fail.

/// Largest radius of inflation, cells.
pub const DISC_CELLS_MAX: usize = 60;
/// Most nodes of a tree. The time of a search grows with their square.
pub const NODES_MAX: usize = 4096;

const _: () = assert!(NODES_MAX < u16::MAX as usize, "a node's index is a u16");
