//! The policy's weights as they are shown.

use serde::Serialize;
use shm_config::message::PolicyStatus;

/// The note on weights in use that the controller could not write to the disk.
pub const UNKEPT: &str =
    "not written to the disk, so a restart does not begin with them (controller.log says why)";

/// The policy's weights.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PolicyView {
    /// Version in use; 0 for none.
    pub version: u64,
    /// First 8 bytes of its SHA-256, hex.
    pub hash: String,
    /// The version last offered.
    pub offered_version: u64,
    /// The state of that offer.
    pub state: &'static str,
    /// Why it was refused or rolled back; else empty.
    pub reason: String,
    /// Whether the version in use is on the disk: a restart begins with it.
    pub is_kept: bool,
}

impl PolicyView {
    /// From the controller's status; `None` before the first offer.
    pub fn of(status: &PolicyStatus) -> Option<Self> {
        (status.offered_version > 0).then(|| Self {
            version: status.version,
            hash: format!("{:016x}", status.hash),
            offered_version: status.offered_version,
            state: status.state().word(),
            reason: status.refusal().into_owned(),
            is_kept: status.unkept == 0,
        })
    }
}

impl std::fmt::Display for PolicyView {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.version {
            0 => write!(f, "no weights in use")?,
            version => write!(f, "weights {version} ({})", &self.hash[..8])?,
        }
        if !self.is_kept {
            write!(f, ", {UNKEPT}")?;
        }
        match (self.offered_version == self.version, self.reason.as_str()) {
            (true, _) => Ok(()),
            (false, "") => write!(f, ", {} {}", self.offered_version, self.state),
            (false, reason) => write!(f, ", {} {}: {reason}", self.offered_version, self.state),
        }
    }
}
