//! `clean`: removes what killed runs left behind, and only that.

use crate::cli::parsers::Name;
use clap::Args;
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt;

use shm_config::file::user;
use shm_config::run::{RunName, RunPaths};

use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::run::leftovers::{Cleaned, clean_run, print_strangers};
use crate::run::shared_memory::SHARED_MEMORY_DIR;

/// Remove what killed runs left behind.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  ./vlaps clean")]
pub struct Clean {
    /// Name of the run; without it, all of them.
    #[arg(long, value_name = "NAME", value_parser = Name)]
    pub run: Option<RunName>,
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
        print_strangers(&paths)?;
        match clean_run(&paths)? {
            Cleaned::Alive => say(format_args!("run '{name}': alive, unchanged")),
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

/// Each run that left a folder or shared memory. Files of other users are ignored.
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
