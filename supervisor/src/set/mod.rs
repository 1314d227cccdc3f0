//! set

pub mod backoff;
pub mod event;
pub mod launch;
pub mod log;
pub mod member;
pub mod orphans;
pub mod process_set;
pub mod stop;
pub mod table;
