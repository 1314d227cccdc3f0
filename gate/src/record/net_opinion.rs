use serde::{Deserialize, Serialize};
use shm_config::message::Preference;

use super::Said;

/// What a distilled net thought of a question, and what became of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NetOpinion {
    /// How probable it is that the expert's path is safer, 0 to 1; `None` when the net
    /// could not be asked.
    pub expert: Option<f64>,
    /// How probable it is that the policy's path is safer.
    pub policy: Option<f64>,
    /// How probable it is that neither is clearly safer.
    pub similar: Option<f64>,
    /// Why the net was not sure and the slow judge answered; `None` if the net answered.
    pub passed_on: Option<Unsure>,
    /// The slow judge's answer beside that of the net, in one word: `expert`, `policy`,
    /// `abstain` or `failed`; `None` if it was not asked for it.
    pub audit: Option<String>,
}

/// Why a net does not answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Unsure {
    /// Its confidence is below its threshold.
    Doubt,
    /// A feature lies outside those that it has learned from.
    Novel,
    /// The question has no features, or the answer was no number.
    Unfit,
}

impl NetOpinion {
    /// The net's answer, with "similar" as a case of its own.
    pub(super) fn said(&self, preference: Option<Preference>) -> Said {
        let is_similar = self.similar > self.policy;
        match preference {
            Some(Preference::Policy) if is_similar => Said::Similar,
            preference => Said::of(preference, &[]),
        }
    }
}
