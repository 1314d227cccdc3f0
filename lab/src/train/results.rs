//! What an experiment's folders hold.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use learner::journal::last_mark;
use serde::{Deserialize, Serialize};

use crate::metric::Metric;

/// What a training's process set is configured with, in its folder.
pub const CONFIG: &str = "train.toml";

/// An evaluation after a block: shares and means over its episodes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exam {
    /// Steps trained for.
    pub steps: u64,
    /// Arrived, contacts or not.
    pub success: f64,
    /// Arrived without having touched anything.
    pub strict_success: f64,
    /// Touched a vehicle or an object at any tick.
    pub contact: f64,
    /// Touching something at the last tick: the paper's crash.
    pub crash_last_step: f64,
    /// Left the road.
    pub out_of_road: f64,
    /// Ran out of steps.
    pub max_step: f64,
    /// Share of the route driven.
    pub completion: f64,
    /// Ticks of an episode.
    pub mean_length: f64,
    /// Length driven by time, m/s.
    pub mean_speed_mps: f64,
}

impl Exam {
    /// One of its figures.
    pub fn of(&self, metric: Metric) -> f64 {
        match metric {
            Metric::Success => self.success,
            Metric::StrictSuccess => self.strict_success,
            Metric::CrashLastStep => self.crash_last_step,
            Metric::Contact => self.contact,
            Metric::OutOfRoad => self.out_of_road,
            Metric::MaxStep => self.max_step,
            Metric::Completion => self.completion,
            Metric::MeanLength => self.mean_length,
            Metric::MeanSpeed => self.mean_speed_mps,
        }
    }
}

/// A block, as the learner has written it down.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct Block {
    /// Steps trained for.
    pub steps: u64,
    /// Updates made.
    pub updates: u64,
    /// Steps at which the policy did not drive, from the start.
    pub interventions: u64,
    /// Steps whose label prefers the expert, from the start.
    pub labels_expert: u64,
    /// Steps whose label prefers the policy, from the start.
    pub labels_policy: u64,
    /// Loss of the actor.
    pub actor_loss: f64,
    /// Loss of the imitation.
    pub imitation_loss: f64,
    /// Loss of the critics.
    pub critic_loss: f64,
    /// Steps that were driven while the learner was away.
    pub lost: u64,
}

/// The last policy on many episodes.
#[derive(Clone, Debug)]
pub struct Final {
    /// Steps it was trained for.
    pub steps: u64,
    /// As `./vlaps eval --json` has it.
    pub evaluation: serde_json::Value,
}

/// One training.
#[derive(Clone, Debug)]
pub struct Seed {
    /// Its seed.
    pub seed: u64,
    /// Its folder.
    pub folder: PathBuf,
    /// Its blocks.
    pub blocks: Vec<Block>,
    /// Their evaluations.
    pub exams: Vec<Exam>,
    /// The last policy, if it was evaluated on many episodes.
    pub last: Option<Final>,
}

impl Seed {
    /// What its process set is configured with.
    pub fn config_file(&self) -> PathBuf {
        self.folder.join(CONFIG)
    }
}

/// The best of all evaluations.
#[derive(Clone, Copy, Debug)]
pub struct Best<'a> {
    /// Of which training.
    pub seed: &'a Seed,
    /// Its figures.
    pub exam: &'a Exam,
}

impl Best<'_> {
    /// The file of its policy.
    pub fn policy(&self) -> PathBuf {
        self.seed.folder.join(policy_file(self.exam.steps))
    }
}

/// All trainings of an experiment.
#[derive(Clone, Debug)]
pub struct Results {
    /// By seed.
    pub seeds: Vec<Seed>,
}

impl Results {
    /// Reads an experiment's folder; trainings without a block are left out.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn read(out: &Path) -> anyhow::Result<Results> {
        let mut seeds = Vec::new();
        for (seed, folder) in seed_folders(out)? {
            let seed = Seed {
                seed,
                blocks: blocks(&folder)?,
                exams: exams(&folder)?,
                last: last(&folder)?,
                folder,
            };
            if !seed.blocks.is_empty() {
                seeds.push(seed);
            }
        }
        Ok(Results { seeds })
    }

    /// What learnt, by the configuration of the first seed.
    pub fn algorithm(&self) -> String {
        let file = self.seeds.first().map(Seed::config_file);
        let text = file.and_then(|file| fs::read_to_string(file).ok());
        let table: Option<toml::Table> = text.and_then(|text| text.parse().ok());
        let word =
            table.and_then(|table| Some(table["learner"].get("algorithm")?.as_str()?.into()));
        word.unwrap_or_else(|| "unknown algorithm".into())
    }

    /// The best evaluation: the most untouched arrivals, then the most arrivals, then
    /// the farthest completion, then the latest.
    pub fn best(&self) -> Option<Best<'_>> {
        let all = self
            .seeds
            .iter()
            .flat_map(|seed| seed.exams.iter().map(move |exam| Best { seed, exam }));
        all.max_by(|a, b| {
            let key = |exam: &Exam| (exam.strict_success, exam.success, exam.completion);
            let by_figures = key(a.exam).partial_cmp(&key(b.exam));
            by_figures
                .unwrap_or(std::cmp::Ordering::Equal)
                .then(a.exam.steps.cmp(&b.exam.steps))
        })
    }

    /// The JSON object of `--json`.
    pub fn summary(&self) -> serde_json::Value {
        let seeds = self.seeds.iter().map(|seed| {
            serde_json::json!({
                "seed": seed.seed,
                "steps": seed.blocks.last().map(|block| block.steps),
                "interventions": seed.blocks.last().map(|block| block.interventions),
                "lost": seed.blocks.last().map(|block| block.lost),
                "last_exam": seed.exams.last(),
                "final": seed.last.as_ref().map(|last| &last.evaluation),
            })
        });
        serde_json::json!({ "seeds": seeds.collect::<Vec<_>>() })
    }
}

/// An experiment's trainings by seed, begun or not; none of a folder that is not
/// there.
///
/// # Errors
/// When the folder cannot be read.
pub fn seed_folders(out: &Path) -> anyhow::Result<Vec<(u64, PathBuf)>> {
    let entries = match fs::read_dir(out) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(error).with_context(|| out.display().to_string()),
    };
    let mut found = Vec::new();
    for entry in entries {
        let folder = entry?.path();
        let name = folder.file_name().and_then(|name| name.to_str());
        if let Some(seed) = name.and_then(|name| name.strip_prefix("seed-")?.parse().ok()) {
            found.push((seed, folder));
        }
    }
    found.sort();
    Ok(found)
}

/// Steps at the end of a training's last block; 0 before its first one.
///
/// # Errors
/// When the file cannot be read.
pub fn steps(folder: &Path) -> anyhow::Result<u64> {
    Ok(blocks(folder)?.last().map_or(0, |block| block.steps))
}

/// A training's blocks.
///
/// # Errors
/// When the file cannot be read.
pub fn blocks(folder: &Path) -> anyhow::Result<Vec<Block>> {
    rows(&blocks_path(folder))
}

/// Steps that a training has driven and that its learner knows of, after the last
/// block, too.
///
/// # Errors
/// When the replay cannot be read.
pub fn driven(folder: &Path) -> anyhow::Result<u64> {
    let replay = folder.join("learner").join("replay.bin");
    let mark = last_mark(&replay).with_context(|| replay.display().to_string())?;
    let counted = mark.map_or(0, |mark| mark.counts.driven());
    Ok(counted.max(steps(folder)?))
}

/// A training's policies with their steps, the first ones first.
///
/// # Errors
/// When the folder cannot be read; one that is not there yet is empty.
pub fn policies(folder: &Path) -> anyhow::Result<Vec<(u64, PathBuf)>> {
    let path = folder.join("learner").join("policies");
    let entries = match fs::read_dir(&path) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(error).with_context(|| path.display().to_string()),
    };
    let mut found = Vec::new();
    for entry in entries {
        let file = entry?.path();
        let stem = file.file_stem().and_then(|stem| stem.to_str());
        let is_policy = file.extension().is_some_and(|end| end == "onnx");
        if let (true, Some(Ok(steps))) = (is_policy, stem.map(str::parse)) {
            found.push((steps, file));
        }
    }
    found.sort();
    Ok(found)
}

/// A block's policy within the folder of its training.
pub fn policy_file(steps: u64) -> String {
    format!("learner/policies/{steps:08}.onnx")
}

fn blocks_path(folder: &Path) -> PathBuf {
    folder.join("learner").join("blocks.csv")
}

fn exams_path(folder: &Path) -> PathBuf {
    folder.join("evaluations.csv")
}

/// The evaluations after a training's blocks.
///
/// # Errors
/// When the file cannot be read.
pub fn exams(folder: &Path) -> anyhow::Result<Vec<Exam>> {
    rows(&exams_path(folder))
}

/// Appends an evaluation.
///
/// # Errors
/// When the file cannot be written.
pub fn append_exam(folder: &Path, exam: &Exam) -> anyhow::Result<()> {
    let path = exams_path(folder);
    let named = || path.display().to_string();
    let is_new = !path.exists();
    let file = fs::OpenOptions::new()
        .create(true)
        .append(true)
        .open(&path)
        .with_context(named)?;
    let mut writer = csv::WriterBuilder::new()
        .has_headers(is_new)
        .from_writer(file);
    writer.serialize(exam).with_context(named)?;
    writer.flush().with_context(named)
}

/// The rows of a CSV file; none of one that is not there. A last row that is
/// being written is left out.
fn rows<T: for<'de> Deserialize<'de>>(path: &Path) -> anyhow::Result<Vec<T>> {
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(error).with_context(|| path.display().to_string()),
    };
    let whole = text.rfind('\n').map_or("", |end| &text[..=end]);
    csv::Reader::from_reader(whole.as_bytes())
        .deserialize()
        .collect::<Result<_, _>>()
        .with_context(|| path.display().to_string())
}

fn last(folder: &Path) -> anyhow::Result<Option<Final>> {
    let path = folder.join("final.json");
    let Ok(text) = fs::read_to_string(&path) else {
        return Ok(None);
    };
    let evaluation: serde_json::Value =
        serde_json::from_str(&text).with_context(|| path.display().to_string())?;
    let steps = evaluation["steps"].as_u64().unwrap_or_default();
    // Trained further since: it says nothing of the last policy any more.
    let is_last = policies(folder)?
        .last()
        .is_some_and(|(last, _)| *last == steps);
    Ok(is_last.then_some(Final { steps, evaluation }))
}
