//! How often a judge is right, on scenes where the simulator knows.

pub mod scenes;
