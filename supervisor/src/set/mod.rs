//! The process set: its table, and each process from its start to its end.

pub mod backoff;
pub mod event;
pub mod exit;
pub mod launch;
pub mod mark;
pub mod member;
pub mod orphans;
pub mod privileges;
pub mod process_set;
pub mod stop;
pub mod table;
