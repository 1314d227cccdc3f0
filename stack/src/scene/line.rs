//! One scene as one line of JSON.

use serde::{Deserialize, Serialize};
use shm_config::message::PlanOutcome;
use shm_config::seen::Seen;

use super::{Origin, Scene};

/// A scene as it is written.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Line {
    seed: u64,
    outcome: String,
    observation: Seen,
    before: Option<Seen>,
}

impl Line {
    /// A scene to be written.
    pub(super) fn new(scene: &Scene) -> Line {
        Line {
            seed: scene.origin.seed,
            outcome: scene.origin.outcome.word().into(),
            observation: Seen::new(&scene.observation),
            before: scene.before.as_deref().map(Seen::new),
        }
    }

    /// A line of a file.
    ///
    /// # Errors
    /// In words, with the field that is wrong.
    pub(super) fn parse(text: &str) -> Result<Scene, String> {
        let line: Line = serde_json::from_str(text).map_err(|error| explain(text, &error))?;
        let named = |name: &'static str| move |error: String| format!("{name}.{error}");
        let outcome = PlanOutcome::ALL
            .iter()
            .copied()
            .find(|outcome| outcome.word() == line.outcome)
            .ok_or_else(|| format!("outcome: \"{}\" is no outcome of a plan", line.outcome))?;
        let before = line.before.as_ref().map(Seen::observation).transpose();
        Ok(Scene {
            origin: Origin {
                seed: line.seed,
                outcome,
            },
            observation: line
                .observation
                .observation()
                .map_err(named("observation"))?,
            before: before.map_err(named("before"))?,
        })
    }
}

/// What a line's error means, with the field before it: the library names only
/// fields that are missing or too many.
fn explain(text: &str, error: &serde_json::Error) -> String {
    let column = error.column().min(text.len());
    let before = text.get(..column).unwrap_or(text);
    let words = error.to_string();
    let words = match words.rfind(" at line ") {
        Some(end) => &words[..end],
        None => &words,
    };
    match field_before(before) {
        Some(field) => format!("{field}: {words} (column {column})"),
        None => format!("{words} (column {column})"),
    }
}

/// The last `"field":` of a text.
fn field_before(text: &str) -> Option<&str> {
    let end = text.rfind("\":")?;
    let begin = text[..end].rfind('"')?;
    Some(&text[begin + 1..end])
}
