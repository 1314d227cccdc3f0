//! The end of this process with its parent: a set that another program drives ends with
//! that program.

use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

use crate::cli::failure::Failure;

/// Has the kernel kill this process, and with it all processes of the run, when its parent
/// ends in any way.
///
/// # Errors
/// When the parent has ended already, or `parent` is not this process's parent.
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
