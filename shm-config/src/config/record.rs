use serde::{Deserialize, Serialize};

use super::{Config, OutOfRange, in_range};

/// What the recorder keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Keep {
    /// Everything in real time, nothing in lockstep.
    Auto,
    /// Nothing; the recorder is not part of the run.
    Nothing,
    /// Every message.
    Everything,
    /// The last minute in memory, written on an event.
    Flight,
}

/// The recorder process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Record {
    /// What is recorded: everything in real time and nothing in lockstep (auto), nothing,
    /// everything, or the last minute when something happens (flight).
    pub keep: Keep,
    /// Folder of the recording; empty for a new folder in run.folder/recording.
    pub folder: String,
    /// Most space of the recordings in that folder, MB; the oldest files are deleted.
    pub max_mb: u32,
    /// How often topics of standard ROS 2 types are recorded for other viewers, Hz; 0 for
    /// never.
    pub standard_hz: f64,
}

impl Default for Record {
    fn default() -> Self {
        Self {
            keep: Keep::Nothing,
            folder: String::new(),
            max_mb: 2048,
            standard_hz: 10.0,
        }
    }
}

impl Record {
    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        // Two policy files of 8 MB, which every file encloses, and an eighth for messages.
        in_range("record.max_mb", self.max_mb, 64..=10_000_000)?;
        in_range("record.standard_hz", self.standard_hz, 0.0..=100.0)
    }
}

impl Config {
    /// What this run records; never [`Keep::Auto`].
    pub fn keeps(&self) -> Keep {
        match (self.record.keep, self.run.is_lockstep()) {
            (Keep::Auto, true) => Keep::Nothing,
            (Keep::Auto, false) => Keep::Everything,
            (keep, _) => keep,
        }
    }
}
