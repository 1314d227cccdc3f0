//! The locks on a run's files: that of its supervisor, and that of all its members.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::Duration;

use rustix::fs::FlockOperation;

use super::holder::{Holder, record};
use super::{
    ALIVE_FILE, CONFIG_FILE, NODES_DIR, RunError, RunPaths, SERVICES_DIR, SUPERVISOR_FILE,
};
use crate::file::Access;

/// Tries to take the supervisor's lock, and the time between two: 0.5 s. A process that
/// looks whether the lock is free holds it for microseconds, one that removes a dead run's
/// files for milliseconds.
const HOLD_TRIES: u32 = 500;
const HOLD_AGAIN: Duration = Duration::from_millis(1);

/// A lock on one of the run's files, dropped with the value or the process.
#[derive(Debug)]
pub struct RunLock {
    file: File,
}

impl RunPaths {
    /// Marks the calling process as part of the run until it ends.
    ///
    /// # Errors
    /// When the file cannot be made or locked.
    pub fn hold_alive(&self) -> Result<RunLock, RunError> {
        let file = self.open_made(ALIVE_FILE)?;
        let path = self.dir().join(ALIVE_FILE);
        if !lock(&path, &file, FlockOperation::NonBlockingLockShared)? {
            return Err(RunError::Io {
                path,
                source: io::Error::other("the run is being cleaned up; try again"),
            });
        }
        match is_in_place(&path, &file)? {
            true => Ok(RunLock { file }),
            false => self.hold_alive(),
        }
    }

    /// Takes the lock of the run's supervisor, and writes the process id and start to
    /// its file; `None` when another supervisor of the run lives. It waits up to half a
    /// second for a process that only looks at the lock, or removes a dead run.
    ///
    /// # Errors
    /// When the folder or the file cannot be used.
    pub fn hold_supervisor(&self) -> Result<Option<RunLock>, RunError> {
        for _ in 1..HOLD_TRIES {
            match self.held() {
                Ok(Some(lock)) => return Ok(Some(lock)),
                // A set that is up keeps the lock.
                Ok(None) if self.supervisor_pid().is_some() => return Ok(None),
                Err(error) if !error.is_missing() => return Err(error),
                // It is busy, or a run that ends has removed the folder in between.
                _ => std::thread::park_timeout(HOLD_AGAIN),
            }
        }
        self.held()
    }

    /// The supervisor's lock; `None` when another process holds it now.
    fn held(&self) -> Result<Option<RunLock>, RunError> {
        let file = self.open_made(SUPERVISOR_FILE)?;
        let path = self.supervisor_file();
        if !lock(&path, &file, FlockOperation::NonBlockingLockExclusive)? {
            return Ok(None);
        }
        if !is_in_place(&path, &file)? {
            return self.held();
        }
        record(&file).map_err(|source| RunError::of(&path, source))?;
        Ok(Some(RunLock { file }))
    }

    /// Whether the file of a supervisor's lock is still in its place, together with the
    /// files that a process needs to join the run.
    ///
    /// # Errors
    /// When the system refuses to examine them.
    pub fn is_held(&self, lock: &RunLock) -> Result<bool, RunError> {
        if !is_in_place(&self.supervisor_file(), &lock.file)? {
            return Ok(false);
        }
        for name in [ALIVE_FILE, CONFIG_FILE, NODES_DIR, SERVICES_DIR] {
            let path = self.dir().join(name);
            match path.try_exists() {
                Ok(true) => {}
                Ok(false) => return Ok(false),
                Err(error) => return Err(RunError::of(&path, error)),
            }
        }
        Ok(true)
    }

    /// The process that holds the supervisor's lock, also while the place is being
    /// cleaned; `None` when it is free.
    ///
    /// # Errors
    /// When the run's folder or the file is not ours, or cannot be used.
    pub fn holder(&self) -> Result<Option<Holder>, RunError> {
        let path = self.supervisor_file();
        let file = match self.folder().and_then(|folder| {
            folder
                .open_file(SUPERVISOR_FILE, Access::Read)
                .map_err(|error| RunError::of(&path, error))
        }) {
            Ok(file) => file,
            Err(error) if error.is_missing() => return Ok(None),
            Err(error) => return Err(error),
        };
        match lock(&path, &file, FlockOperation::NonBlockingLockShared)? {
            true => Ok(None),
            false => Ok(Holder::of(&file)),
        }
    }
}

/// Tries to lock; `false` when another process holds it.
pub(super) fn lock(path: &Path, file: &File, operation: FlockOperation) -> Result<bool, RunError> {
    match rustix::fs::flock(file, operation) {
        Ok(()) => Ok(true),
        Err(rustix::io::Errno::WOULDBLOCK) => Ok(false),
        Err(error) => Err(RunError::Io {
            path: path.into(),
            source: error.into(),
        }),
    }
}

/// Whether a locked file is still at its path. A run that was just ending may have removed it
/// in between, and other processes do not see a lock on a removed file.
pub(super) fn is_in_place(path: &Path, file: &File) -> Result<bool, RunError> {
    let failed = |source| RunError::of(path, source);
    let locked = file.metadata().map_err(failed)?.ino();
    match fs::symlink_metadata(path) {
        Ok(found) => Ok(found.ino() == locked),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(failed(error)),
    }
}
