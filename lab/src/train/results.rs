//! Reads and writes the results in an experiment's folder.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use learner::journal::last_mark;
use serde::{Deserialize, Serialize};

use super::protocol::{EVALUATION_SEED, HELD_BACK_SEED};
use crate::metric::Metric;

/// Configuration file of a training's process set, in its folder.
pub const CONFIG: &str = "train.toml";

/// Evaluation after a block: shares and means over its episodes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BlockEvaluation {
    /// Number of training steps.
    pub steps: u64,
    /// Share of episodes that arrived, with or without contacts.
    pub success: f64,
    /// Share of episodes that arrived without any contact.
    pub strict_success: f64,
    /// Share of episodes with a contact at any tick.
    pub contact: f64,
    /// Share of episodes with a contact at the last tick: the paper's crash.
    pub crash_last_step: f64,
    /// Share of episodes that left the road.
    pub out_of_road: f64,
    /// Share of episodes that reached the maximum number of steps.
    pub max_step: f64,
    /// Mean share of the route that was driven.
    pub completion: f64,
    /// Mean number of ticks of an episode.
    pub mean_length: f64,
    /// Driven length over time, m/s.
    pub mean_speed_mps: f64,
}

impl BlockEvaluation {
    /// The value of a metric.
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

/// A block, as recorded by the learner.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct Block {
    /// Number of training steps at its end.
    pub steps: u64,
    /// Number of updates in it.
    pub updates: u64,
    /// Steps since the start at which the policy did not drive.
    pub interventions: u64,
    /// Steps since the start whose label prefers the expert.
    pub labels_expert: u64,
    /// Steps since the start whose label prefers the policy.
    pub labels_policy: u64,
    /// Answers of the expert since the start that the algorithm learnt from, at driven steps
    /// and at imagined states; `None` in the file of an earlier version.
    #[serde(default)]
    pub expert_queries: Option<u64>,
    /// Loss of the actor.
    pub actor_loss: f64,
    /// Loss of the imitation.
    pub imitation_loss: f64,
    /// Loss of the critics.
    pub critic_loss: f64,
    /// Steps that the learner missed.
    pub lost: u64,
}

/// Evaluation of the last policy on many episodes.
#[derive(Clone, Debug)]
pub struct Final {
    /// Number of steps that the policy was trained for.
    pub steps: u64,
    /// The JSON object of `./vlaps eval --json`.
    pub evaluation: serde_json::Value,
}

/// An evaluation of last policies on many episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FinalSeeds {
    /// Seeds 1000 and up, whose first 50 also give the evaluation after each block.
    Evaluation,
    /// Seeds 50000 and up, on request.
    HeldBack,
}

impl FinalSeeds {
    /// Both, in the order in which they are printed.
    pub const ALL: [FinalSeeds; 2] = [FinalSeeds::Evaluation, FinalSeeds::HeldBack];

    /// The first seed.
    pub fn first(self) -> u64 {
        match self {
            FinalSeeds::Evaluation => EVALUATION_SEED,
            FinalSeeds::HeldBack => HELD_BACK_SEED,
        }
    }

    /// Its file in the folder of a training.
    pub fn file(self) -> &'static str {
        match self {
            FinalSeeds::Evaluation => "final.json",
            FinalSeeds::HeldBack => "held-back.json",
        }
    }
}

/// One training.
#[derive(Clone, Debug)]
pub struct Seed {
    /// Seed of the training.
    pub seed: u64,
    /// Folder of the training.
    pub folder: PathBuf,
    /// The blocks.
    pub blocks: Vec<Block>,
    /// The evaluations after the blocks.
    pub block_evaluations: Vec<BlockEvaluation>,
    /// The evaluation of the last policy on many episodes, if there is one.
    pub last: Option<Final>,
    /// The same on the held-back seeds.
    pub held_back: Option<Final>,
}

impl Seed {
    /// The last policy's evaluation on these seeds, if there is one.
    pub fn final_on(&self, seeds: FinalSeeds) -> Option<&Final> {
        match seeds {
            FinalSeeds::Evaluation => self.last.as_ref(),
            FinalSeeds::HeldBack => self.held_back.as_ref(),
        }
    }

    /// Reads the folder of a training.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn read(seed: u64, folder: PathBuf) -> anyhow::Result<Seed> {
        Ok(Seed {
            seed,
            blocks: blocks(&folder)?,
            block_evaluations: block_evaluations(&folder)?,
            last: last(&folder, FinalSeeds::Evaluation)?,
            held_back: last(&folder, FinalSeeds::HeldBack)?,
            folder,
        })
    }

    /// Whether all steps are trained, every block is evaluated, and the last policy too.
    pub fn is_complete(&self, steps: u64, final_episodes: u64) -> bool {
        let trained = self.blocks.last().map(|block| block.steps);
        let evaluated = self.block_evaluations.last().map(|block| block.steps);
        let last = self.last.as_ref();
        let last = last.and_then(|last| last.evaluation["episodes"].as_u64());
        trained == Some(steps)
            && evaluated == Some(steps)
            && (final_episodes == 0 || last == Some(final_episodes))
    }

    /// The configuration file of the process set.
    pub fn config_file(&self) -> PathBuf {
        self.folder.join(CONFIG)
    }
}

/// The best of all evaluations.
#[derive(Clone, Copy, Debug)]
pub struct Best<'a> {
    /// The training.
    pub seed: &'a Seed,
    /// The evaluation.
    pub block_evaluation: &'a BlockEvaluation,
}

impl Best<'_> {
    /// The policy file.
    pub fn policy(&self) -> PathBuf {
        self.seed
            .folder
            .join(policy_file(self.block_evaluation.steps))
    }
}

/// All trainings of an experiment.
#[derive(Clone, Debug)]
pub struct Results {
    /// The trainings, sorted by seed.
    pub seeds: Vec<Seed>,
}

impl Results {
    /// Reads an experiment's folder; trainings without a block are left out.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn read(out: &Path) -> anyhow::Result<Results> {
        let mut seeds = Vec::new();
        for (seed, folder) in seed_folders(out)? {
            let seed = Seed::read(seed, folder)?;
            if !seed.blocks.is_empty() {
                seeds.push(seed);
            }
        }
        Ok(Results { seeds })
    }

    /// The algorithm in the configuration of the first seed.
    pub fn algorithm(&self) -> String {
        let file = self.seeds.first().map(Seed::config_file);
        let text = file.and_then(|file| fs::read_to_string(file).ok());
        let table: Option<toml::Table> = text.and_then(|text| text.parse().ok());
        let word =
            table.and_then(|table| Some(table["learner"].get("algorithm")?.as_str()?.into()));
        word.unwrap_or_else(|| "unknown algorithm".into())
    }

    /// The best evaluation: by strict successes, then successes, then completion, then
    /// steps.
    pub fn best(&self) -> Option<Best<'_>> {
        let all = self.seeds.iter().flat_map(|seed| {
            seed.block_evaluations
                .iter()
                .map(move |block_evaluation| Best {
                    seed,
                    block_evaluation,
                })
        });
        all.max_by(|a, b| {
            let key = |block_evaluation: &BlockEvaluation| {
                (
                    block_evaluation.strict_success,
                    block_evaluation.success,
                    block_evaluation.completion,
                )
            };
            let by_figures = key(a.block_evaluation).partial_cmp(&key(b.block_evaluation));
            by_figures
                .unwrap_or(std::cmp::Ordering::Equal)
                .then(a.block_evaluation.steps.cmp(&b.block_evaluation.steps))
        })
    }

    /// The JSON object of `--json`.
    pub fn summary(&self) -> serde_json::Value {
        let seeds = self.seeds.iter().map(|seed| {
            serde_json::json!({
                "seed": seed.seed,
                "steps": seed.blocks.last().map(|block| block.steps),
                "interventions": seed.blocks.last().map(|block| block.interventions),
                "expert_queries": seed.blocks.last().and_then(|block| block.expert_queries),
                "lost": seed.blocks.last().map(|block| block.lost),
                "last_evaluation": seed.block_evaluations.last(),
                "final": seed.last.as_ref().map(|last| &last.evaluation),
                "held_back": seed.held_back.as_ref().map(|last| &last.evaluation),
            })
        });
        serde_json::json!({ "seeds": seeds.collect::<Vec<_>>() })
    }
}

/// Folders of an experiment's trainings by seed, begun or not; none if the folder does
/// not exist.
///
/// # Errors
/// If the folder cannot be read.
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

/// Number of steps at the end of a training's last block; 0 without a block.
///
/// # Errors
/// If the file cannot be read.
pub fn steps(folder: &Path) -> anyhow::Result<u64> {
    Ok(blocks(folder)?.last().map_or(0, |block| block.steps))
}

/// The blocks of a training.
///
/// # Errors
/// If the file cannot be read.
pub fn blocks(folder: &Path) -> anyhow::Result<Vec<Block>> {
    rows(&blocks_path(folder))
}

/// Number of driven steps that the learner has received, including those after the last
/// block.
///
/// # Errors
/// If the replay file cannot be read.
pub fn driven(folder: &Path) -> anyhow::Result<u64> {
    let replay = folder.join("learner").join("replay.bin");
    let mark = last_mark(&replay).with_context(|| replay.display().to_string())?;
    let counted = mark.map_or(0, |mark| mark.counts.driven());
    Ok(counted.max(steps(folder)?))
}

/// The policies of a training with their steps, in ascending order; none if the folder does
/// not exist yet.
///
/// # Errors
/// If the folder cannot be read.
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

/// Path of a block's policy within the folder of its training.
pub fn policy_file(steps: u64) -> String {
    format!("learner/policies/{steps:08}.onnx")
}

fn blocks_path(folder: &Path) -> PathBuf {
    folder.join("learner").join("blocks.csv")
}

fn block_evaluations_path(folder: &Path) -> PathBuf {
    folder.join("evaluations.csv")
}

/// The evaluations after the blocks of a training.
///
/// # Errors
/// If the file cannot be read.
pub fn block_evaluations(folder: &Path) -> anyhow::Result<Vec<BlockEvaluation>> {
    rows(&block_evaluations_path(folder))
}

/// Appends an evaluation.
///
/// # Errors
/// If the file cannot be written.
pub fn append_block_evaluation(
    folder: &Path,
    block_evaluation: &BlockEvaluation,
) -> anyhow::Result<()> {
    let path = block_evaluations_path(folder);
    let named = || path.display().to_string();
    cut_torn_row(&path).with_context(named)?;
    let is_new = !path.exists();
    let file = fs::OpenOptions::new()
        .create(true)
        .append(true)
        .open(&path)
        .with_context(named)?;
    let mut writer = csv::WriterBuilder::new()
        .has_headers(is_new)
        .from_writer(file);
    writer.serialize(block_evaluation).with_context(named)?;
    writer.flush().with_context(named)
}

/// Removes the incomplete last row that a killed process left: the next row would continue
/// it.
fn cut_torn_row(path: &Path) -> std::io::Result<()> {
    let bytes = match fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error),
    };
    let whole = bytes.iter().rposition(|byte| *byte == b'\n');
    match whole.map_or(0, |end| end + 1) {
        length if length == bytes.len() => Ok(()),
        // Without a header the file is begun again.
        0 => fs::remove_file(path),
        length => fs::OpenOptions::new()
            .write(true)
            .open(path)?
            .set_len(length as u64),
    }
}

/// The rows of a CSV file; none if it does not exist. An incomplete last row, which is being
/// written, is left out.
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

fn last(folder: &Path, seeds: FinalSeeds) -> anyhow::Result<Option<Final>> {
    let path = folder.join(seeds.file());
    let Ok(text) = fs::read_to_string(&path) else {
        return Ok(None);
    };
    // A file that a killed process or a copy left incomplete counts as missing.
    let Ok(evaluation) = serde_json::from_str::<serde_json::Value>(&text) else {
        return Ok(None);
    };
    let steps = evaluation["steps"].as_u64().unwrap_or_default();
    // The training has continued since: this is not the last policy any more.
    let is_last = policies(folder)?
        .last()
        .is_some_and(|(last, _)| *last == steps);
    Ok(is_last.then_some(Final { steps, evaluation }))
}
