//! What happens in a set, for the screen and the supervisor's log.

use std::fmt;

use shm_config::services::Process;

use crate::set::exit::Exit;

/// What happened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// A process was started.
    Started {
        /// Which.
        process: Process,
        /// Its process id.
        pid: u32,
    },
    /// A process became ready.
    Ready {
        /// Which.
        process: Process,
    },
    /// A process died and will be restarted.
    Died {
        /// Which.
        process: Process,
        /// How.
        exit: Exit,
        /// Pause before the restart, ns.
        pause_ns: u64,
        /// The how-manieth restart this is.
        restart: u32,
        /// How many there may be.
        restarts_max: u32,
    },
    /// A process that said nothing was killed.
    Silenced {
        /// Which.
        process: Process,
        /// How long it had said nothing, ns.
        silent_ns: u64,
    },
    /// A log file could not be rotated.
    LogFull {
        /// Whose.
        process: Process,
        /// Why.
        reason: String,
    },
}

impl Event {
    /// Worth a line on the screen, not only in the log.
    pub fn is_notable(&self) -> bool {
        match self {
            Self::Started { .. } | Self::Ready { .. } => false,
            Self::Died { .. } | Self::Silenced { .. } | Self::LogFull { .. } => true,
        }
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Started { process, pid } => write!(f, "{process}: started, process {pid}"),
            Self::Ready { process } => write!(f, "{process}: ready"),
            Self::Died {
                process,
                exit,
                pause_ns,
                restart,
                restarts_max,
            } => write!(
                f,
                "{process}: died ({exit}); restart {restart} of {restarts_max} in {} ms",
                pause_ns / 1_000_000
            ),
            Self::Silenced { process, silent_ns } => write!(
                f,
                "{process}: silent for {:.1} s, killed",
                *silent_ns as f64 / 1e9
            ),
            Self::LogFull { process, reason } => {
                write!(f, "{process}: its log cannot be rotated: {reason}")
            }
        }
    }
}
