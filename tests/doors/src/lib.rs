//! The entry points of the stack: they take bytes and refuse them, or return a value
//! that later code can use without a panic.
//!
//! Each function is the body of a fuzz target in `fuzz/` and is replayed over the
//! checked-in corpora by `tests/corpora.rs`, on a stable compiler.

mod bytes;
mod files;
mod learning;
mod messages;
mod processes;
mod recordings;

pub use bytes::{as_bytes, read};
pub use files::{answers, config, policy};
pub use learning::{checkpoint, journal, records};
pub use messages::{KINDS, messages};
pub use processes::{controller, planner, steps, world};
pub use recordings::{recording, viewer};

/// The result of an entry point. A corpus with only one of them tests nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Said {
    /// A value was admitted and used.
    Admitted,
    /// Everything was refused.
    Refused,
}

impl Said {
    fn of(is_admitted: bool) -> Self {
        match is_admitted {
            true => Self::Admitted,
            false => Self::Refused,
        }
    }
}

/// A target: its name in `fuzz/`, and its body.
pub type Target = (&'static str, fn(&[u8]) -> Said);

/// All of them.
pub const TARGETS: &[Target] = &[
    ("messages", messages),
    ("planner", planner),
    ("controller", controller),
    ("steps", steps),
    ("world", world),
    ("config", config),
    ("policy", policy),
    ("answers", answers),
    ("records", records),
    ("journal", journal),
    ("checkpoint", checkpoint),
    ("recording", recording),
    ("viewer", viewer),
];
