//! When a run's place is open to observers.
//!
//! A supervisor holds its run's lock before it removes what an earlier set left, and until
//! its own files are removed. A process that joins in these times keeps the place from being
//! clean. So the supervisor writes a marker into the clean place and removes it before its
//! files, and observers see the run only while the marker is there.

use super::holder::own_record;
use super::{NUMBER_BYTES_MAX, RunError, RunLock, RunPaths};
use crate::file::Durable;

/// The marker. It names the process that wrote it: that of a killed supervisor stays until
/// the next one has cleaned the place.
const OPENED_FILE: &str = "opened";

impl RunPaths {
    /// Shows the run to observers, once its place is clean; the lock is the supervisor's.
    ///
    /// # Errors
    /// When the marker cannot be written.
    pub fn open(&self, _lock: &RunLock) -> Result<(), RunError> {
        self.folder()?
            .replace(OPENED_FILE, own_record().as_bytes(), Durable::No)
            .map_err(|error| RunError::of(&self.dir().join(OPENED_FILE), error))
    }

    /// Hides the run from observers, before its files are removed.
    pub fn close(&self) {
        // If the marker cannot be removed, observers see the run until its lock is free.
        if let Ok(ours) = self.folder() {
            let _ = ours.remove(OPENED_FILE);
        }
    }

    /// The process id of the run's living supervisor, for processes that join the run;
    /// `None` when there is none, its place is being cleaned, or the run's folder is not
    /// the user's.
    pub fn supervisor_pid(&self) -> Option<u32> {
        // The marker is read first: without it, the lock that a starting set wants is left
        // alone.
        let marker = self.folder().ok()?.read(OPENED_FILE, NUMBER_BYTES_MAX);
        let marker = marker.ok()?;
        let holder = self.holder().ok().flatten()?;
        holder.is_named_in(&marker).then_some(holder.pid)
    }
}
