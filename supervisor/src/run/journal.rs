//! The journal: the supervisor's own log.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use runtime::LogFile;
use shm_config::Instant;
use shm_config::config::Config;
use shm_config::services::Process;

use crate::cli::failure::Failure;

/// The supervisor's own log.
pub struct Journal {
    log: LogFile,
    file: File,
    begun: Instant,
}

impl Journal {
    /// Opens the journal in a folder of logs.
    ///
    /// # Errors
    /// When the log cannot be made.
    pub fn open(dir: &Path, config: &Config, now: Instant) -> Result<Self, Failure> {
        let failed = |error: io::Error| {
            Failure::GivenUp(format!("{}: cannot keep a log: {error}", dir.display()))
        };
        let limit_bytes = u64::from(config.supervisor.log_mb) << 20;
        let mut log =
            LogFile::create(dir, Process::Supervisor.word(), limit_bytes).map_err(failed)?;
        let file = log.begin().map_err(failed)?;
        Ok(Self {
            log,
            file,
            begun: now,
        })
    }

    /// Adds a line, with the time since it was opened.
    pub fn line(&mut self, now: Instant, text: &str) {
        let passed_s = now.since_ns(self.begun) as f64 / 1e9;
        // A full disk must stop only the journal, not the car.
        let text = shm_config::text::printable(text);
        let _ = writeln!(self.file, "{passed_s:9.3} {text}");
        let _ = self.log.rotate();
    }
}
