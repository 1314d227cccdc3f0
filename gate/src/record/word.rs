//! The answer as it stands in a record's line: one word.

use serde::de::{Deserialize, Deserializer, Error};
use serde::ser::Serializer;
use shm_config::message::Preference;

/// The word of an answer; `None` means no answer.
const WORDS: [(Option<Preference>, &str); 4] = [
    (Some(Preference::Expert), "expert"),
    (Some(Preference::Policy), "policy"),
    (Some(Preference::Abstain), "abstain"),
    (None, "failed"),
];

#[allow(clippy::trivially_copy_pass_by_ref)] // the signature that serde calls
pub fn serialize<S: Serializer>(
    preference: &Option<Preference>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let word = WORDS.iter().find(|(answer, _)| answer == preference);
    serializer.serialize_str(word.map_or("failed", |(_, word)| word))
}

pub fn deserialize<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<Preference>, D::Error> {
    let text = String::deserialize(deserializer)?;
    let known = WORDS.iter().find(|(_, word)| *word == text);
    let unknown = || D::Error::unknown_variant(&text, &["expert", "policy", "abstain", "failed"]);
    known.map(|(answer, _)| *answer).ok_or_else(unknown)
}
