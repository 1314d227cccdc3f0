//! The file of a distilled judge: an ONNX file with the keys below, checked as strictly as
//! a policy file.
//!
//! | key | value |
//! |---|---|
//! | `vlaps.kind` | [`KIND`] |
//! | `vlaps.judge.format` | [`FORMAT_VERSION`] |
//! | `vlaps.judge.layout` | [`QUESTION_LAYOUT`], 16 hex digits |
//! | `vlaps.judge.members` | nets in it; their probabilities are averaged |
//! | `vlaps.judge.temperature` | what their scores are divided by |
//! | `vlaps.judge.threshold` | the confidence from which on it answers |
//! | `vlaps.judge.low` `vlaps.judge.high` | the ends of each feature in training |
//! | `vlaps.judge.teacher` `vlaps.judge.preset` `vlaps.judge.model` | whose answers it has learned |
//! | `vlaps.judge.learned` | `answers` or `outcomes` |
//! | `vlaps.judge.questions` `vlaps.judge.seed` `vlaps.judge.commit` | how it was trained |

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use policy::{Chain, Refusal, Shape, decode_chain, encode_chain};
use shm_config::file;
use shm_config::message::WEIGHTS_BYTES_MAX;

use super::features::{INPUTS, QUESTION_LAYOUT};
use super::net::{DistilledNet, OUTPUTS};

/// The kind of the file.
pub const KIND: &str = "judge";
/// The format that this crate writes, and the only one it reads.
pub const FORMAT_VERSION: u32 = 1;
/// Most nets of a file.
pub const MEMBERS_MAX: usize = 16;
/// What a feature may exceed the range of the training by, as a share of that range and
/// of the feature's scale: two drives differ by more than two scenes of one.
const BEYOND: f32 = 0.1;

/// What a file says about its net.
#[derive(Debug, Clone, PartialEq)]
pub struct About {
    /// Nets in it.
    pub members: usize,
    /// What their scores are divided by.
    pub temperature: f64,
    /// The confidence from which on it answers, 0.5 to 1; above 1 it never answers.
    pub threshold: f64,
    /// The features of the training.
    pub range: Range,
    /// What kind of judge taught it, a word of `shm_config::message::Judge`.
    pub teacher: String,
    /// The prompt preset of the teacher; empty for a judge without a prompt.
    pub preset: String,
    /// The model that taught it; empty for none.
    pub model: String,
    /// What it has learned: `answers` or `outcomes`.
    pub learned: String,
    /// Questions that it has learned from.
    pub questions: u64,
    /// Seed of the training.
    pub seed: u64,
    /// Commit of the program that trained.
    pub commit: String,
}

/// The least and the greatest value of each feature.
#[derive(Debug, Clone, PartialEq)]
pub struct Range {
    /// The least values.
    pub low: Vec<f32>,
    /// The greatest values.
    pub high: Vec<f32>,
}

impl Range {
    /// The range of these rows; that of no row holds nothing.
    pub fn of<'a>(rows: impl IntoIterator<Item = &'a [f32; INPUTS]>) -> Self {
        let mut range = Self {
            low: vec![f32::MAX; INPUTS],
            high: vec![f32::MIN; INPUTS],
        };
        for row in rows {
            for (k, value) in row.iter().enumerate() {
                range.low[k] = range.low[k].min(*value);
                range.high[k] = range.high[k].max(*value);
            }
        }
        range
    }

    /// Whether a feature lies clearly outside.
    pub fn is_outside(&self, row: &[f32]) -> bool {
        let ends = self.low.iter().zip(&self.high);
        row.iter().zip(ends).any(|(value, (low, high))| {
            let beyond = BEYOND * (1.0 + (high - low).max(0.0));
            // In this form NaN is outside.
            !(*value >= low - beyond && *value <= high + beyond)
        })
    }
}

/// A file that is not read.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The system refuses.
    #[error("{}: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The file is no distilled judge that this build can use.
    #[error(
        "{}: {refusal}; it must be a file that ./vlaps judge distil of this build has written",
        path.display()
    )]
    Refused {
        /// The file.
        path: PathBuf,
        /// Why.
        refusal: Refusal,
    },
}

/// Reads and checks the file of a distilled judge.
///
/// # Errors
/// When it cannot be read, is no regular file or longer than a policy may be, or a check fails.
pub fn read(path: &Path) -> Result<DistilledNet, FileError> {
    let unreadable = |source| FileError::Unreadable {
        path: path.into(),
        source,
    };
    let bytes = file::read(path, WEIGHTS_BYTES_MAX as u64).map_err(unreadable)?;
    decode(&bytes).map_err(|refusal| FileError::Refused {
        path: path.into(),
        refusal,
    })
}

/// The net of these bytes.
///
/// # Errors
/// The first check that fails.
pub fn decode(bytes: &[u8]) -> Result<DistilledNet, Refusal> {
    let shape = |metadata: &BTreeMap<String, String>| {
        let about = about(metadata)?;
        Ok(Shape {
            inputs: INPUTS,
            outputs: OUTPUTS * about.members,
        })
    };
    let file = decode_chain(KIND, bytes, shape)?;
    Ok(DistilledNet::new(file.chain, about(&file.metadata)?))
}

/// The file of these layers.
pub fn encode(net: &DistilledNet) -> Vec<u8> {
    let about = &net.about;
    let row = |values: &[f32]| {
        let numbers: Vec<_> = values.iter().map(f32::to_string).collect();
        numbers.join(",")
    };
    let entries = [
        ("judge.format", FORMAT_VERSION.to_string()),
        ("judge.layout", layout_word()),
        ("judge.members", about.members.to_string()),
        ("judge.temperature", about.temperature.to_string()),
        ("judge.threshold", about.threshold.to_string()),
        ("judge.low", row(&about.range.low)),
        ("judge.high", row(&about.range.high)),
        ("judge.teacher", about.teacher.clone()),
        ("judge.preset", about.preset.clone()),
        ("judge.model", about.model.clone()),
        ("judge.learned", about.learned.clone()),
        ("judge.questions", about.questions.to_string()),
        ("judge.seed", about.seed.to_string()),
        ("judge.commit", about.commit.clone()),
    ];
    encode_chain(KIND, net.chain(), &entries)
}

/// A net of these layers.
///
/// # Errors
/// When the layers do not have the shape of a distilled judge.
pub fn assemble(layers: Vec<policy::Layer>, about: About) -> Result<DistilledNet, Refusal> {
    let shape = Shape {
        inputs: INPUTS,
        outputs: OUTPUTS * about.members,
    };
    Ok(DistilledNet::new(Chain::new(layers, shape)?, about))
}

fn layout_word() -> String {
    format!("{QUESTION_LAYOUT:016x}")
}

/// The metadata without the net.
fn about(metadata: &BTreeMap<String, String>) -> Result<About, Refusal> {
    let text = |key: &str| {
        let value = metadata.get(&format!("judge.{key}"));
        value.ok_or_else(|| broken(key, "is missing"))
    };
    let format: u32 = number(text("format")?, "format")?;
    if format != FORMAT_VERSION {
        let what = format!("format {format}, this build reads {FORMAT_VERSION}");
        return Err(broken("format", &what));
    }
    if *text("layout")? != layout_word() {
        return Err(Refusal::WrongLayout {
            theirs: text("layout")?.chars().take(40).collect(),
            ours: layout_word(),
        });
    }
    let members: usize = number(text("members")?, "members")?;
    if !(1..=MEMBERS_MAX).contains(&members) {
        return Err(broken("members", &format!("must be 1 to {MEMBERS_MAX}")));
    }
    let range = Range {
        low: row(text("low")?, "low")?,
        high: row(text("high")?, "high")?,
    };
    Ok(About {
        members,
        temperature: within(text("temperature")?, "temperature", [1e-3, 1e3])?,
        threshold: within(text("threshold")?, "threshold", [0.5, 2.0])?,
        range,
        teacher: text("teacher")?.clone(),
        preset: text("preset")?.clone(),
        model: text("model")?.clone(),
        learned: text("learned")?.clone(),
        questions: number(text("questions")?, "questions")?,
        seed: number(text("seed")?, "seed")?,
        commit: text("commit")?.clone(),
    })
}

fn broken(key: &str, what: &str) -> Refusal {
    Refusal::Metadata {
        key: format!("vlaps.judge.{key}"),
        what: what.into(),
    }
}

fn number<T: std::str::FromStr>(text: &str, key: &str) -> Result<T, Refusal> {
    let shown: String = text.chars().take(40).collect();
    text.parse()
        .map_err(|_| broken(key, &format!("{shown:?} is no such number")))
}

fn within(text: &str, key: &str, [least, most]: [f64; 2]) -> Result<f64, Refusal> {
    let value: f64 = number(text, key)?;
    match (least..=most).contains(&value) {
        true => Ok(value),
        false => Err(broken(key, &format!("must lie within {least} and {most}"))),
    }
}

fn row(text: &str, key: &str) -> Result<Vec<f32>, Refusal> {
    let numbers = text.split(',').take(INPUTS + 1);
    let numbers: Vec<f32> = numbers
        .map(|text| number(text, key))
        .collect::<Result<_, _>>()?;
    match numbers.len() == INPUTS && numbers.iter().all(|value| value.is_finite()) {
        true => Ok(numbers),
        false => Err(broken(key, &format!("must be {INPUTS} finite numbers"))),
    }
}
