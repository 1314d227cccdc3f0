//! Why shared memory refuses a port: the library reports what it could not do, and the
//! state of the machine shows why.

use std::fs;

use rustix::process::{Resource, getrlimit};

use crate::run::SHARED_MEMORY_DIR;

/// Distance to the limit of open files at which a port cannot be opened any more: a
/// port opens a few files, and closes them when it fails.
const SPARE_FILES: u64 = 8;
/// Free shared memory below which a port may not fit, bytes: the largest part that is
/// written when a port is opened.
const SPARE_BYTES: u64 = 1 << 20;

/// The cause in words, with what to do.
pub(super) fn of(what: &str) -> String {
    if what.contains("ExceedsMax") {
        return "all places are taken: other processes hold ports of this run; end them, or \
                start a run of another name with --run"
            .into();
    }
    if let Some(limit) = getrlimit(Resource::Nofile).current
        && open_files().is_none_or(|files| files + SPARE_FILES > limit)
    {
        return format!(
            "the process may have {limit} files open and has about as many; raise the limit \
             with `ulimit -n 1024`"
        );
    }
    if let Some(limit) = getrlimit(Resource::As).current {
        return format!(
            "the address space is limited to {} MB; lift the limit with `ulimit -v unlimited`",
            limit >> 20
        );
    }
    if let Some(free) = free_bytes().filter(|free| *free < SPARE_BYTES) {
        return format!(
            "{} KB are free in {SHARED_MEMORY_DIR}; `./vlaps doctor` shows the space, \
             `./vlaps clean` frees what dead runs left",
            free >> 10
        );
    }
    "the run's files were removed or written over while it drives; `./vlaps down` ends the run"
        .into()
}

/// `None` when no descriptor is left to count them with.
fn open_files() -> Option<u64> {
    let entries = fs::read_dir("/proc/self/fd").ok()?;
    Some(entries.count() as u64)
}

fn free_bytes() -> Option<u64> {
    let space = rustix::fs::statvfs(SHARED_MEMORY_DIR).ok()?;
    Some(space.f_bavail.saturating_mul(space.f_frsize))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cause_is_named_and_not_guessed() {
        let taken = of("ExceedsMaxSupportedPublishers");
        assert!(taken.contains("all places are taken"), "{taken}");
        let other = of("ServiceInCorruptedState");
        assert!(!other.contains("places are taken"), "{other}");
    }
}
