//! The policy's weights as they are shown.

use serde::Serialize;
use shm_config::message::PolicyStatus;

/// The policy's weights.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PolicyView {
    /// Version in use; 0 for none.
    pub version: u64,
    /// First 8 bytes of its SHA-256, hex.
    pub hash: String,
    /// Version last offered.
    pub offered_version: u64,
    /// Its state.
    pub state: &'static str,
    /// Why it was refused or rolled back; else empty.
    pub reason: String,
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
        })
    }
}

impl std::fmt::Display for PolicyView {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.version {
            0 => write!(f, "no weights in use")?,
            version => write!(f, "weights {version} ({})", &self.hash[..8])?,
        }
        match (self.offered_version == self.version, self.reason.as_str()) {
            (true, _) => Ok(()),
            (false, "") => write!(f, ", {} {}", self.offered_version, self.state),
            (false, reason) => write!(f, ", {} {}: {reason}", self.offered_version, self.state),
        }
    }
}
