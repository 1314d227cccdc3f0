//! `clean`: removes what killed runs left behind, and only that.

use std::collections::BTreeMap;
use std::fs;

use shm_config::run::{Leftovers, RunName, RunPaths};

use crate::arguments::Clean;
use crate::failure::Failure;
use crate::place::SHARED_MEMORY_DIR;
use crate::screen::say;

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
    for (name, paths) in runs().into_iter().filter(|(name, _)| asked(name)) {
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

/// Every run that left a folder or shared memory: somebody may have emptied
/// the folder for temporary files since.
fn runs() -> BTreeMap<String, RunPaths> {
    let user = rustix::process::getuid().as_raw();
    let prefix = format!("vlaps-{user}-");
    let in_memory = fs::read_dir(SHARED_MEMORY_DIR)
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| {
            let file = entry.file_name();
            let name = file.to_str()?.strip_prefix(&prefix)?.split('.').next()?;
            name.parse::<RunName>().ok()
        })
        .map(RunPaths::new);
    RunPaths::all()
        .into_iter()
        .chain(in_memory)
        .map(|paths| (paths.name().to_string(), paths))
        .collect()
}
