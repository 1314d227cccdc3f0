//! The files and shared memory that a killed run leaves behind.

use shm_config::run::{Leftovers, RunPaths};

use crate::cli::failure::Failure;
use crate::cli::print::say;

/// The most names that are printed: another user may create any number of them.
const STRANGERS_PRINTED: usize = 8;

/// The result for one run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cleaned {
    /// A process of it lives; its files are unchanged.
    Alive,
    /// It was dead; these files were removed.
    Removed(Leftovers),
}

/// Prints the files that are named like a run's shared memory and do not belong to it.
///
/// # Errors
/// When the folder of shared memory cannot be read.
pub fn print_strangers(paths: &RunPaths) -> Result<(), Failure> {
    let strangers = paths.strangers()?;
    for stranger in strangers.iter().take(STRANGERS_PRINTED) {
        say(stranger);
    }
    match strangers.len().checked_sub(STRANGERS_PRINTED) {
        None | Some(0) => {}
        Some(more) => say(format_args!(
            "{more} more names like those of run '{}' are left alone",
            paths.name()
        )),
    }
    Ok(())
}

/// Removes what one run left, if it is dead.
///
/// # Errors
/// When a leftover cannot be removed.
pub fn clean_run(paths: &RunPaths) -> Result<Cleaned, Failure> {
    // While this lock is held, no new supervisor of that name starts.
    let Some(_lock) = paths.hold_supervisor()? else {
        return Ok(Cleaned::Alive);
    };
    match paths.clean_if_dead()? {
        None => Ok(Cleaned::Alive),
        Some(leftovers) => {
            paths.remove_dir();
            Ok(Cleaned::Removed(leftovers))
        }
    }
}
