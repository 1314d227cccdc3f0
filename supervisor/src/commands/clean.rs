//! `clean`: removes what killed runs left behind, and only that.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt;

use shm_config::file::user;
use shm_config::run::{Leftovers, RunName, RunPaths};

use crate::arguments::Clean;
use crate::cli::failure::Failure;
use crate::run::place::SHARED_MEMORY_DIR;
use crate::show::screen::say;

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

/// Cleans the named run, or all of the calling user, where they are dead.
///
/// # Errors
/// When a leftover cannot be removed.
pub fn clean(arguments: &Clean) -> Result<(), Failure> {
    let mut removed = 0;
    let asked = |name: &str| match &arguments.run {
        Some(run) => run.to_string() == name,
        None => true,
    };
    for (name, paths) in runs()?.into_iter().filter(|(name, _)| asked(name)) {
        tell_strangers(&paths)?;
        match clean_run(&paths)? {
            Cleaned::Alive => say(format_args!("run '{name}': alive, left alone")),
            Cleaned::Removed(leftovers) => {
                removed += 1;
                say(format_args!(
                    "run '{name}': dead, removed {} files and {} KB of shared memory",
                    leftovers.files,
                    leftovers.bytes >> 10
                ));
            }
        }
    }
    if removed == 0 {
        say("nothing to remove");
    }
    Ok(())
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

/// Every run that left a folder or shared memory: the folder may have been emptied
/// since. Of what others have named like it, there is nothing to clean.
fn runs() -> Result<BTreeMap<String, RunPaths>, Failure> {
    let user = user();
    let prefix = format!("vlaps-{user}-");
    let in_memory = fs::read_dir(SHARED_MEMORY_DIR)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| entry.metadata().is_ok_and(|found| found.uid() == user))
        .filter_map(|entry| {
            let file = entry.file_name();
            let name = file.to_str()?.strip_prefix(&prefix)?.split('.').next()?;
            name.parse::<RunName>().ok()
        })
        .map(RunPaths::new);
    Ok(RunPaths::all()?
        .into_iter()
        .chain(in_memory)
        .map(|paths| (paths.name().to_string(), paths))
        .collect())
}
