//! Where a recording is from: its metadata.

use std::collections::BTreeMap;

use crate::FORMAT;

/// The name of the metadata that counts lost messages.
pub(crate) const LOST: &str = "vlaps.lost";
/// The name of the metadata record.
pub(crate) const METADATA: &str = "vlaps.recording";
/// The keys that [`Origin`] has fields for.
const KEYS: [&str; 5] = ["format", "run", "session", "lockstep", "epoch_offset_ns"];

/// The run that a recording is of.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Origin {
    /// Name of the run.
    pub run: String,
    /// Distinguishes this start of the run from others of the same name.
    pub session: String,
    /// Whether the run's clock is simulated.
    pub is_lockstep: bool,
    /// Epoch time minus the run's clock, ns.
    pub epoch_offset_ns: u64,
    /// All else: `commit`, `processor`, `binary.NAME` (SHA-256), ...
    pub facts: BTreeMap<String, String>,
}

impl Origin {
    /// A fact; `unknown` when the recording does not say.
    pub fn fact(&self, key: &str) -> &str {
        self.facts.get(key).map_or("unknown", String::as_str)
    }

    /// As the metadata record.
    pub(crate) fn to_metadata(&self) -> BTreeMap<String, String> {
        let lockstep = u8::from(self.is_lockstep).to_string();
        let values = [
            FORMAT.to_string(),
            self.run.clone(),
            self.session.clone(),
            lockstep,
            self.epoch_offset_ns.to_string(),
        ];
        let keys = KEYS.map(String::from).into_iter();
        let facts = self.facts.clone().into_iter();
        facts.chain(keys.zip(values)).collect()
    }

    /// From the metadata record: the format and the origin; the key that is missing or no
    /// number else.
    pub(crate) fn from_metadata(
        mut facts: BTreeMap<String, String>,
    ) -> Result<(u32, Self), &'static str> {
        let mut take = |key: &'static str| facts.remove(key).ok_or(key);
        let [format, run, session, lockstep, offset] = [
            take("format")?,
            take("run")?,
            take("session")?,
            take("lockstep")?,
            take("epoch_offset_ns")?,
        ];
        let origin = Self {
            run,
            session,
            is_lockstep: lockstep == "1",
            epoch_offset_ns: offset.parse().map_err(|_| "epoch_offset_ns")?,
            facts,
        };
        Ok((format.parse().map_err(|_| "format")?, origin))
    }
}
