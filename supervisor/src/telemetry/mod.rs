//! telemetry

pub mod episodes;
pub mod judge;
pub mod late;
pub mod ports;
pub mod tally;
pub mod timing;
