//! The events of a process set, for the screen and the supervisor's log.

use std::fmt;

use shm_config::services::Process;

use crate::set::exit::Exit;

/// An event.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// A process was started.
    Started {
        /// The process.
        process: Process,
        /// Its process id.
        pid: u32,
    },
    /// A process became ready.
    Ready {
        /// The process.
        process: Process,
    },
    /// A process died and will be restarted.
    Died {
        /// The process.
        process: Process,
        /// How it ended.
        exit: Exit,
        /// Pause before the restart, ns.
        pause_ns: u64,
        /// The number of this restart, from 1.
        restart: u32,
        /// The limit of restarts.
        restarts_max: u32,
    },
    /// A process died after its last restart; the run goes on without it.
    Abandoned {
        /// The process.
        process: Process,
        /// How it ended.
        exit: Exit,
        /// The limit of restarts.
        restarts_max: u32,
    },
    /// A silent process was killed.
    Silenced {
        /// The process.
        process: Process,
        /// How long it had published no health message, ns.
        silent_ns: u64,
    },
    /// A log file could not be rotated.
    LogFull {
        /// The process.
        process: Process,
        /// The reason.
        reason: String,
    },
}

impl Event {
    /// Whether the screen shows it, and not only the log.
    pub fn is_notable(&self) -> bool {
        match self {
            Self::Started { .. } | Self::Ready { .. } => false,
            Self::Died { .. }
            | Self::Abandoned { .. }
            | Self::Silenced { .. }
            | Self::LogFull { .. } => true,
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
            Self::Abandoned {
                process,
                exit,
                restarts_max,
            } => write!(
                f,
                "{process}: died ({exit}) and was restarted {restarts_max} times already, which is \
                 supervisor.restarts_max; the run goes on without it"
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
