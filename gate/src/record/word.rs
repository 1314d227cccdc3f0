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

/// The word of an answer.
pub fn of(preference: Option<Preference>) -> &'static str {
    let word = WORDS.iter().find(|(answer, _)| *answer == preference);
    word.map_or("failed", |(_, word)| word)
}

/// The answer of a word; `None` for another word.
pub fn read(text: &str) -> Option<Option<Preference>> {
    let known = WORDS.iter().find(|(_, word)| *word == text);
    known.map(|(answer, _)| *answer)
}

#[allow(clippy::trivially_copy_pass_by_ref)] // the signature that serde calls
pub fn serialize<S: Serializer>(
    preference: &Option<Preference>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(of(*preference))
}

pub fn deserialize<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<Preference>, D::Error> {
    let text = String::deserialize(deserializer)?;
    let unknown = || D::Error::unknown_variant(&text, &["expert", "policy", "abstain", "failed"]);
    read(&text).ok_or_else(unknown)
}
