use serde::{Deserialize, Serialize};

use super::{Config, OutOfRange};
use crate::services::Process;

/// Processes of a run on other machines (`./vlaps setup link` builds the program).
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Link {
    /// Where the vehicle waits for a judge of another machine, HOST:PORT of an address of
    /// its own; empty for a gate process on this machine. The car does not wait: without a
    /// judge the expert drives.
    pub judge: String,
    /// The same for the learner; empty for one on this machine.
    pub learner: String,
}

impl Link {
    /// The program that stands in the place of a process, and where it listens; `None` for
    /// a process of this machine.
    pub fn of(&self, process: Process) -> Option<(&'static str, &str)> {
        let (program, address) = match process {
            Process::Gate => ("vlaps-link-judge", &self.judge),
            Process::Learner => ("vlaps-link-learner", &self.learner),
            _ => return None,
        };
        (!address.is_empty()).then_some((program, address.as_str()))
    }

    pub(super) fn check(&self, config: &Config) -> Result<(), OutOfRange> {
        let refused = |key: &str, value: &str, expected: &str| {
            Err(OutOfRange {
                key: key.into(),
                value: format!("{value:?}"),
                expected: expected.into(),
            })
        };
        for (key, address) in [("link.judge", &self.judge), ("link.learner", &self.learner)] {
            if !address.is_empty() && !is_address(address) {
                let expected = "HOST:PORT, such as 0.0.0.0:7450, or empty";
                return refused(key, address, expected);
            }
        }
        match () {
            () if !self.judge.is_empty() && !config.programs.gate.is_empty() => {
                let expected = "empty beside programs.gate: one of them is the judge";
                refused("link.judge", &self.judge, expected)
            }
            () if !self.judge.is_empty() && !config.gate.has_process() => {
                let expected = "empty, or gate.mode = \"rules\", which has a gate process";
                refused("link.judge", &self.judge, expected)
            }
            () if !self.learner.is_empty() && !config.learner.enabled => {
                let expected = "empty, or learner.enabled = true";
                refused("link.learner", &self.learner, expected)
            }
            () if !self.judge.is_empty() && self.judge == self.learner => refused(
                "link.learner",
                &self.learner,
                "another port than link.judge",
            ),
            () => Ok(()),
        }
    }
}

/// Whether a text is HOST:PORT.
pub fn is_address(text: &str) -> bool {
    let host_and_port = text.rsplit_once(':');
    host_and_port.is_some_and(|(host, port)| {
        let plain = |c: char| c.is_ascii_alphanumeric() || ".-:[]".contains(c);
        let is_port = port.parse::<u16>().is_ok_and(|port| port > 0);
        !host.is_empty() && host.len() <= 253 && host.chars().all(plain) && is_port
    })
}
