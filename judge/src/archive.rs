use std::path::Path;
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread::{self, JoinHandle};

use shm_config::config::Config;

use crate::Filed;
use crate::store::{Lost, Store, StoreError};

/// Records that may wait for the disk; more are lost, and counted.
const WAITING_MAX: usize = 64;

/// Writes records on a thread of its own: a disk that stalls holds up no advice.
pub struct Archive {
    records: Option<SyncSender<Filed>>,
    thread: Option<JoinHandle<()>>,
    lost: u64,
}

impl Archive {
    /// Of the run's folder, `judge` in it.
    ///
    /// # Errors
    /// When the folder cannot be made.
    pub fn open(config: &Config) -> Result<Self, StoreError> {
        let folder = Path::new(&config.run.folder).join("judge");
        let mut store = Store::open(&folder, config.vlm.record_bytes_max)?;
        let (records, filed) = sync_channel::<Filed>(WAITING_MAX);
        let thread = thread::spawn(move || {
            while let Ok(Filed { record, pictures }) = filed.recv() {
                let question = store.begin(record, &pictures);
                store.complete(question);
            }
            let Lost {
                lines,
                pictures,
                reason,
            } = store.lost();
            if lines + pictures > 0 {
                tracing::warn!(lines, pictures, reason, "not all was kept of the questions");
            }
        });
        Ok(Self {
            records: Some(records),
            thread: Some(thread),
            lost: 0,
        })
    }

    /// Hands records over; those for which there is no room are lost.
    pub fn keep(&mut self, filed: Vec<Filed>) {
        let Some(records) = &self.records else {
            return;
        };
        for filed in filed {
            match records.try_send(filed) {
                Ok(()) => {}
                Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => self.lost += 1,
            }
        }
    }

    /// Waits until all that was handed over is written.
    pub fn close(mut self) {
        drop(self.records.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        if self.lost > 0 {
            tracing::warn!(lost = self.lost, "records of questions were lost");
        }
    }
}
