//! What a killed run leaves behind.

use shm_config::run::{Leftovers, RunPaths};

use crate::cli::failure::Failure;
use crate::cli::print::say;

/// Names that are told one by one: a user may make any number of them.
const STRANGERS_TOLD: usize = 8;

/// What became of one run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cleaned {
    /// A process of it lives; nothing was touched.
    Alive,
    /// It was dead; this was removed.
    Removed(Leftovers),
}

/// Says what is named as a run's shared memory and is none of it.
///
/// # Errors
/// When the folder of shared memory cannot be read.
pub fn tell_strangers(paths: &RunPaths) -> Result<(), Failure> {
    let strangers = paths.strangers()?;
    for stranger in strangers.iter().take(STRANGERS_TOLD) {
        say(stranger);
    }
    match strangers.len().checked_sub(STRANGERS_TOLD) {
        None | Some(0) => {}
        Some(more) => say(format_args!(
            "{more} more names like those of run '{}' are left alone",
            paths.name()
        )),
    }
    Ok(())
}

/// Cleans one run, if it is dead.
///
/// # Errors
/// When a leftover cannot be removed.
pub fn clean_run(paths: &RunPaths) -> Result<Cleaned, Failure> {
    // With the supervisor's lock in hand no new supervisor of that name starts.
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
