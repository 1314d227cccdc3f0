//! How a child process ended.

use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

/// Exit code of a child whose configuration or set-up is wrong.
const EXIT_REFUSED: i32 = 2;

/// How a child ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Exit {
    /// Exit code 0.
    Done,
    /// Exit code 2: the same set-up would fail again.
    Refused,
    /// Any other exit, in words.
    Crashed(String),
}

impl From<ExitStatus> for Exit {
    fn from(status: ExitStatus) -> Self {
        match (status.code(), status.signal()) {
            (Some(0), _) => Self::Done,
            (Some(EXIT_REFUSED), _) => Self::Refused,
            (Some(code), _) => Self::Crashed(format!("exit code {code}")),
            (None, Some(signal)) => {
                Self::Crashed(match signal_hook::low_level::signal_name(signal) {
                    Some(name) => format!("killed by {name}"),
                    None => format!("killed by signal {signal}"),
                })
            }
            (None, None) => Self::Crashed(status.to_string()),
        }
    }
}

impl std::fmt::Display for Exit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Done => f.write_str("exit code 0"),
            Self::Refused => f.write_str("exit code 2"),
            Self::Crashed(how) => f.write_str(how),
        }
    }
}
