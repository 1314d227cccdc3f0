use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{Config, Gate, OutOfRange, Simulator};
use crate::services::Process;

/// Programs of a user that run in place of those of the build.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Programs {
    /// Absolute path of the program that is the world, such as a robot; empty for the
    /// world that world.simulator names. A program has its own car: `[vehicle]` has to
    /// describe it.
    pub world: String,
    /// Absolute path of the program that plans; empty for the planner of the build.
    pub planner: String,
    /// Absolute path of the program that reads steps and publishes advice, in place of
    /// the gate process; empty for the gate of the build. It needs a gate.mode that has
    /// a gate process, and gets no API key.
    pub gate: String,
}

impl Programs {
    /// The user's program for a process; `None` for the one of the build.
    pub fn of(&self, process: Process) -> Option<&Path> {
        let path = match process {
            Process::World => &self.world,
            Process::Planner => &self.planner,
            Process::Gate => &self.gate,
            Process::Supervisor | Process::Controller | Process::Learner | Process::Recorder => {
                return None;
            }
        };
        (!path.is_empty()).then_some(Path::new(path))
    }

    pub(super) fn check(&self, gate: &Gate) -> Result<(), OutOfRange> {
        if !self.gate.is_empty() && !gate.has_process() {
            return Err(OutOfRange {
                key: "programs.gate".into(),
                value: format!("{:?}", self.gate),
                expected: "empty, or gate.mode = \"rules\", which starts a gate process".into(),
            });
        }
        if !self.gate.is_empty() && gate.foresight {
            return Err(OutOfRange {
                key: "gate.foresight".into(),
                value: "true".into(),
                expected: "false when programs.gate names a program, which keeps no record".into(),
            });
        }
        for (key, path) in [
            ("programs.world", &self.world),
            ("programs.planner", &self.planner),
            ("programs.gate", &self.gate),
        ] {
            // The processes of a run may have different working folders.
            if !path.is_empty() && !Path::new(path).is_absolute() {
                return Err(OutOfRange {
                    key: key.into(),
                    value: format!("{path:?}"),
                    expected: "an absolute path, or empty for the program of the build".into(),
                });
            }
        }
        Ok(())
    }
}

impl Config {
    /// Whether the world is the built-in one, which can be driven in one process and
    /// recomputed.
    pub fn has_built_in_world(&self) -> bool {
        self.world.simulator == Simulator::BuiltIn && self.programs.world.is_empty()
    }
}
