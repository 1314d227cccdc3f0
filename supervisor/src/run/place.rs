//! The run's place on the machine: taken before anything starts, left empty
//! whatever happens.

use std::time::Duration;

use shm_config::run::{Leftovers, RunLock, RunName, RunPaths};

use crate::cli::failure::Failure;
use crate::machine::signals::pause;

/// How often, and how long each time, the death of an earlier set is awaited:
/// the kernel ends the children of a killed supervisor within milliseconds.
const DEATH_LOOKS: u32 = 40;
const DEATH_LOOK: Duration = Duration::from_millis(50);

/// The run's place. Dropping it removes everything of the run from the machine;
/// what it was for must be dropped before.
#[derive(Debug)]
pub struct Place {
    paths: RunPaths,
    lock: RunLock,
}

impl Place {
    /// Takes the place of a run and clears away what a killed one left in it.
    ///
    /// # Errors
    /// When the run is alive, or its folder cannot be used.
    pub fn take(name: RunName) -> Result<(Self, Leftovers), Failure> {
        let paths = RunPaths::new(name.clone());
        let Some(lock) = paths.hold_supervisor()? else {
            let pid = match paths.supervisor_pid() {
                Some(pid) => format!("by process {pid}"),
                None => "by another supervisor".into(),
            };
            return Err(Failure::Usage(format!(
                "run '{name}' is driven already, {pid}; stop it with `./vlaps down --run {name}` \
                 or drive another beside it with `--run OTHER`"
            )));
        };
        for _ in 0..DEATH_LOOKS {
            if let Some(leftovers) = paths.clean_if_dead()? {
                let place = Self { paths, lock };
                return Ok((place, leftovers));
            }
            pause(DEATH_LOOK);
        }
        Err(Failure::GivenUp(format!(
            "run '{name}': its supervisor is gone, but a process of it lives; find it with \
             `fuser {}`, end it, and try again, or use `--run OTHER`",
            paths.dir().join("alive").display()
        )))
    }

    /// The run's files are still there. Without them nobody who starts can join
    /// those who drive.
    pub fn is_whole(&self) -> bool {
        let shared = self.paths.shared_memory();
        self.paths.is_held(&self.lock) && shared.is_ok_and(|files| !files.is_empty())
    }

    /// The run's paths.
    pub fn paths(&self) -> &RunPaths {
        &self.paths
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        // An onlooker keeps a run alive for a moment. Should one stay, or the
        // file system refuse, the next start cleans.
        for _ in 0..DEATH_LOOKS {
            match self.paths.clean_if_dead() {
                Ok(Some(_)) => return self.paths.remove_dir(),
                Ok(None) => pause(DEATH_LOOK),
                Err(_) => return,
            }
        }
    }
}
