//! The run's place on the machine: locked before any process starts, and left empty however
//! the run ends.

use std::time::Duration;

use shm_config::run::{Holder, Leftovers, RunError, RunLock, RunName, RunPaths};

use crate::cli::failure::Failure;
use crate::machine::signals::pause;

/// How often the end of an earlier set is checked, and the time between two checks: the
/// kernel ends the children of a killed supervisor within milliseconds.
const DEATH_LOOKS: u32 = 40;
const DEATH_LOOK: Duration = Duration::from_millis(50);

/// The run's place. Dropping it removes all files of the run from the machine; drop the
/// ports of the run first.
#[derive(Debug)]
pub struct Place {
    paths: RunPaths,
    lock: RunLock,
}

impl Place {
    /// Locks the place of a run, removes what a killed run left in it, and opens it to
    /// observers.
    ///
    /// # Errors
    /// When the run is alive, or its folder cannot be used.
    pub fn take(name: RunName) -> Result<(Self, Leftovers), Failure> {
        let paths = RunPaths::new(name.clone());
        let Some(lock) = paths.hold_supervisor()? else {
            // One that still cleans its place holds it, too.
            let pid = match paths.holder()? {
                Some(Holder { pid, .. }) => format!("by process {pid}"),
                None => "by another supervisor".into(),
            };
            return Err(Failure::Usage(format!(
                "run '{name}' is driven already, {pid}; stop it with `./vlaps down --run {name}` \
                 or drive another beside it with `--run OTHER`"
            )));
        };
        for _ in 0..DEATH_LOOKS {
            if let Some(leftovers) = paths.clean_if_dead()? {
                paths.open(&lock)?;
                let place = Self { paths, lock };
                return Ok((place, leftovers));
            }
            pause(DEATH_LOOK);
        }
        Err(Failure::GivenUp(format!(
            "run '{name}': its supervisor has ended, but a process of it lives; find it with \
             `fuser {}`, end it, and try again, or use `--run OTHER`",
            paths.dir().join("alive").display()
        )))
    }

    /// Whether the run's files are still there. Without them a process that starts cannot
    /// join the running ones.
    ///
    /// # Errors
    /// When it cannot be known, such as when no more files can be opened.
    pub fn is_whole(&self) -> Result<bool, RunError> {
        Ok(self.paths.is_held(&self.lock)? && !self.paths.shared_memory()?.is_empty())
    }

    /// The run's paths.
    pub fn paths(&self) -> &RunPaths {
        &self.paths
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        // Before its files: an observer that joined now would keep the place from being
        // removed.
        self.paths.close();
        // An observing process keeps a run alive for a moment. If one stays, or the file
        // system refuses, the next start removes the files.
        for _ in 0..DEATH_LOOKS {
            match self.paths.clean_if_dead() {
                Ok(Some(_)) => return self.paths.remove_dir(),
                Ok(None) => pause(DEATH_LOOK),
                Err(_) => return,
            }
        }
    }
}
