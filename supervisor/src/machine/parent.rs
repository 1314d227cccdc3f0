//! A set that another program drives ends with it, as its own processes end with
//! the supervisor.

use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

use crate::cli::failure::Failure;

/// Ties this process to the parent that named itself: when that ends, however it
/// does, the kernel kills this one, and with it all processes of the run.
///
/// # Errors
/// When the parent is gone already, or was never this process's.
pub fn end_with(parent: u32) -> Result<(), Failure> {
    // Refused only for invalid signals.
    let _ = set_parent_process_death_signal(Some(Signal::KILL));
    // It may have ended before the line above.
    let actual = getppid().map(Pid::as_raw_nonzero);
    if actual.map(|pid| pid.get().unsigned_abs()) != Some(parent) {
        return Err(Failure::Usage(format!(
            "--parent {parent}: is not the process that started this one, or has ended"
        )));
    }
    Ok(())
}
