//! The failures that end a command early, and their exit codes.

use shm_config::config::ConfigError;
use shm_config::run::RunError;
use shm_config::wire::WireError;

/// Exit code of a run that had to be given up.
pub const EXIT_FAILED: u8 = 1;
/// Exit code of a wrong command line or configuration.
pub const EXIT_USAGE: u8 = 2;

/// Exit code of a process that a signal ended is this plus the signal's number, as in
/// shells.
pub const EXIT_SIGNAL: u8 = 128;

/// One line for the user: what was wrong, where, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The configuration file or an override.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The command line, or a file that it names.
    #[error("{0}")]
    Usage(String),
    /// The run's folder.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Shared memory.
    #[error(transparent)]
    Wire(#[from] WireError),
    /// The run had to be given up.
    #[error("{0}")]
    GivenUp(String),
    /// A second signal killed the run.
    #[error("killed by a second signal; the car was not brought to a stand")]
    Killed {
        /// The signal's number.
        signal: u8,
    },
}

impl Failure {
    /// API keys cannot be removed from the environment.
    pub fn secrets(error: std::io::Error) -> Self {
        Self::GivenUp(format!(
            "cannot take the keys out of the environment: {error}; unset them and name a file in \
             vlm.key_file"
        ))
    }

    /// The process's exit code.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Config(_) | Self::Usage(_) => EXIT_USAGE,
            Self::Run(_) | Self::Wire(_) | Self::GivenUp(_) => EXIT_FAILED,
            Self::Killed { signal } => EXIT_SIGNAL.saturating_add(*signal),
        }
    }
}
