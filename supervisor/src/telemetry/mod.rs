//! What the messages of a run add up to.

pub mod episodes;
pub mod foreign;
pub mod judge;
pub mod late;
pub mod observe;
pub mod ports;
pub mod process_tally;
pub mod quantiles;
pub mod step_tally;
pub mod tally;
pub mod timing;
