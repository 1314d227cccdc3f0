use serde::Serialize;
use shm_config::config::{PromptPreset, View};

use super::{Hue, Party, Showing};

/// The text that a model gets with one picture, and how its answer is read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Prompt {
    /// The preset, which defines the text and the form of the answer.
    pub preset: PromptPreset,
    /// What the picture shows; the text is made from it.
    pub showing: Showing,
    /// The system message; may be empty.
    pub system: String,
    /// The question.
    pub user: String,
}

/// The description of each view; the stand-in recognises the view by it.
pub const fn view_words(view: View) -> &'static str {
    match view {
        View::Ego => "The picture is taken from a car that drives on a road, looking ahead.",
        View::TopDown => "The picture shows a car on a road from above.",
    }
}

/// The names of the two paths in the blind prompt.
pub const LETTERS: [&str; 2] = Showing::LETTERS;

/// The blind prompt's word for "neither is clearly better".
pub const SIMILAR: &str = "similar";

impl Prompt {
    /// The text for a picture of two paths, each `horizon_s` long.
    pub fn new(preset: PromptPreset, showing: Showing, view: View, horizon_s: f64) -> Self {
        let (system, user) = match preset {
            PromptPreset::Blind => (blind_system(), blind_user(showing.hues, view, horizon_s)),
            // The paper has only a user message (Sec. 8.5).
            PromptPreset::Paper => (String::new(), paper(showing)),
        };
        Self {
            preset,
            showing,
            system,
            user,
        }
    }

    /// The JSON schema of the answer. `None` for the paper's prompt, which asks for a
    /// sentence after the object: a server that enforces a schema would cut it off.
    pub fn schema(&self) -> Option<Schema> {
        match self.preset {
            PromptPreset::Blind => Some(Schema::BLIND),
            PromptPreset::Paper => None,
        }
    }
}

/// The JSON schema of the blind prompt's answer. Servers that compile it into a grammar
/// require the fields in this order: the reason comes first, so that the model has
/// given one when it decides. Ranges are stated in words only, because strict modes
/// differ in the keywords they accept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Schema {
    r#type: &'static str,
    properties: Properties,
    required: [&'static str; 3],
    #[serde(rename = "additionalProperties")]
    additional_properties: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
struct Properties {
    reason: Field,
    response: Field,
    confidence: Field,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
struct Field {
    r#type: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    r#enum: Option<[&'static str; 3]>,
    description: &'static str,
}

impl Schema {
    const BLIND: Self = Self {
        r#type: "object",
        properties: Properties {
            reason: Field {
                r#type: "string",
                r#enum: None,
                description: "One short sentence.",
            },
            response: Field {
                r#type: "string",
                r#enum: Some([LETTERS[0], LETTERS[1], SIMILAR]),
                description: "The safer path.",
            },
            confidence: Field {
                r#type: "number",
                r#enum: None,
                description: "From 0 to 1.",
            },
        },
        required: ["reason", "response", "confidence"],
        additional_properties: false,
    };
}

/// The fixed colours of a preset; `None` if they are drawn at random.
pub fn fixed_showing(preset: PromptPreset) -> Option<Showing> {
    match preset {
        PromptPreset::Blind => None,
        PromptPreset::Paper => Some(Showing::PAPER),
    }
}

fn blind_system() -> String {
    "You compare two paths that a car could take. You go by what the picture shows and by \
     nothing else. You answer with one JSON object and nothing around it."
        .into()
}

fn blind_user(hues: [Hue; 2], view: View, horizon_s: f64) -> String {
    let view = view_words(view);
    let [first, second] = hues.map(Hue::word);
    let [a, b] = LETTERS;
    format!(
        "{view} Two paths are drawn into it, both beginning at the car: path {a} is {first}, \
         path {b} is {second}. Each shows where the car goes in the next {horizon_s} s if it \
         holds one steering angle and one pedal position; which of the two comes first means \
         nothing.\n\n\
         Which path is safer? Safety counts first: a path that meets a vehicle, a person or an \
         obstacle, or that leaves the road or crosses its yellow line, is worse than one that does not; if both do, the \
         one that does so later is the better one; passing close by is worse than keeping a \
         distance. Only where both are equally safe, the one that gets further along the road \
         is the better one. If neither is clearly better, they are {SIMILAR}.\n\n\
         Answer with this JSON object alone: {{\"reason\": one short sentence, \"response\": \
         \"{a}\", \"{b}\" or \"{SIMILAR}\", \"confidence\": a number from 0 to 1}}"
    )
}

/// The answer's form in the paper's prompt; the stand-in recognises the prompt by it.
pub const PAPER_FORM: &str = "{\"response\": <1 or 0>}";

/// The meaning of the paper's prompt (Sec. 8.5): it names the parties, 1 is "the
/// expert is significantly better", 0 "they are similar".
fn paper(showing: Showing) -> String {
    let [expert, novice] = [Party::Expert, Party::Policy].map(|party| showing.hue(party).word());
    format!(
        "The image shows where an expert policy ({expert} path) and a novice policy ({novice} \
         path) would drive. Compare them.\n\n\
         Begin with your decision as a JSON object of exactly this form:\n\
         {PAPER_FORM}\n\n\
         1 means: the expert policy is significantly better than the novice policy.\n\
         0 means: the expert policy is similar to the novice policy.\n\n\
         Then explain the decision in one short sentence. Nothing comes before the JSON object, \
         and nothing is formatted."
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Words that identify a path's owner, or reveal that the owners differ.
    const TELLING: [&str; 16] = [
        "expert", "novice", "policy", "policies", "learned", "learning", "learner", "trained",
        "agent", "planner", "human", "teacher", "student", "baseline", "neural", "network",
    ];

    fn words(text: &str) -> Vec<String> {
        text.to_lowercase()
            .split(|c: char| !c.is_alphanumeric())
            .map(String::from)
            .collect()
    }

    fn showings() -> impl Iterator<Item = Showing> {
        let pairs = Hue::ALL.into_iter().flat_map(|a| Hue::ALL.map(|b| [a, b]));
        pairs
            .filter(|[a, b]| a != b)
            .flat_map(|hues| [Party::Expert, Party::Policy].map(|first| Showing { first, hues }))
    }

    fn all_words(prompt: &Prompt) -> Vec<String> {
        let schema = serde_json::to_string(&prompt.schema()).expect("JSON");
        words(&format!("{} {} {schema}", prompt.system, prompt.user))
    }

    #[test]
    fn the_blind_prompt_identifies_no_party() {
        for view in [View::Ego, View::TopDown] {
            for showing in showings() {
                let prompt = Prompt::new(PromptPreset::Blind, showing, view, 3.0);
                let said = all_words(&prompt);
                let telling = said.iter().find(|word| TELLING.contains(&word.as_str()));
                assert_eq!(telling, None, "{showing:?}");
                let mut swapped = Prompt::new(PromptPreset::Blind, showing.swapped(), view, 3.0);
                assert_ne!(swapped.showing.first, showing.first);
                swapped.showing = showing;
                assert_eq!(swapped, prompt, "the owner of a path changes no word");
            }
        }
    }

    #[test]
    fn the_paper_prompt_names_both_parties() {
        let prompt = Prompt::new(PromptPreset::Paper, Showing::PAPER, View::Ego, 1.5);
        let said = all_words(&prompt);
        assert!(TELLING.iter().any(|word| said.contains(&(*word).into())));
    }

    #[test]
    fn the_colours_named_are_the_showings_in_its_order() {
        let presets = [PromptPreset::Blind, PromptPreset::Paper];
        for preset in presets {
            for showing in showings() {
                let prompt = Prompt::new(preset, showing, View::Ego, 3.0);
                let hues: Vec<_> = all_words(&prompt)
                    .iter()
                    .filter_map(|word| Hue::ALL.into_iter().find(|hue| hue.word() == word))
                    .collect();
                let expected = match preset {
                    PromptPreset::Blind => showing.hues,
                    _ => [Party::Expert, Party::Policy].map(|party| showing.hue(party)),
                };
                assert_eq!(hues, expected, "{preset:?} {showing:?}");
            }
        }
    }

    #[test]
    fn the_papers_prompt_has_the_colours_of_its_figures() {
        let hues = |preset| fixed_showing(preset).expect("fixed").hues;
        assert_eq!(hues(PromptPreset::Paper), [Hue::Red, Hue::Blue]);
        assert_eq!(fixed_showing(PromptPreset::Blind), None);
    }
}
