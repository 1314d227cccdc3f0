//! The checks of real-time priority and locked memory.

use std::thread;

use rustix::mm::MlockAllFlags;
use rustix::process::{Resource, Rlimit, getrlimit};

use super::finding::Finding;
use super::grants;
use crate::set::table::TABLE;

/// The highest priority of the process table.
fn highest_priority() -> u8 {
    TABLE.iter().map(|row| row.priority).max().unwrap_or(0)
}

pub(super) fn priority() -> Finding {
    let asked = highest_priority();
    // On a thread that ends at once, so that the doctor itself stays ordinary.
    let tried = thread::spawn(move || runtime::set_fifo(asked.into()))
        .join()
        .unwrap_or_else(|_| Err(std::io::Error::other("the attempt ended in a panic")));
    let limit = match getrlimit(Resource::Rtprio).current {
        Some(limit) => limit.to_string(),
        None => "unlimited".into(),
    };
    let by_file = tried.is_err() && grants::programs_can(grants::SYS_NICE);
    let found = match &tried {
        Ok(()) => format!("SCHED_FIFO {asked} granted (RLIMIT_RTPRIO {limit})"),
        Err(_) if by_file => format!("SCHED_FIFO {asked} granted to the programs (capabilities)"),
        Err(error) => format!("SCHED_FIFO {asked} refused: {error} (RLIMIT_RTPRIO {limit})"),
    };
    let is_ok = tried.is_ok() || by_file;
    Finding::new("real-time priority", is_ok, found, &grants::lines())
}

pub(super) fn locked_memory() -> Finding {
    let tried = rustix::mm::mlockall(MlockAllFlags::CURRENT);
    if tried.is_ok() {
        // The doctor needs no locked memory.
        let _ = rustix::mm::munlockall();
    }
    let Rlimit { current, .. } = getrlimit(Resource::Memlock);
    let limit = match current {
        Some(bytes) => format!("{} KB", bytes >> 10),
        None => "unlimited".into(),
    };
    let by_file = tried.is_err() && grants::programs_can(grants::IPC_LOCK);
    let found = match tried {
        Ok(()) => format!("granted (RLIMIT_MEMLOCK {limit})"),
        Err(_) if by_file => "granted to the programs (capabilities)".into(),
        Err(error) => format!("refused: {error} (RLIMIT_MEMLOCK {limit})"),
    };
    let is_ok = tried.is_ok() || by_file;
    Finding::new("locked memory", is_ok, found, &grants::lines())
}
