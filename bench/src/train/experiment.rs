//! Which experiment a folder holds: the seeds and lengths it was begun with.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize};

use super::arguments::Train;
use super::results::seed_folders;

/// Steps of a training, unless asked for: the paper's (Sec. 5).
const STEPS: u64 = 50_000;
/// Episodes after each block, unless asked for: the paper's (Sec. 5).
const EVAL_EPISODES: u64 = 50;
/// The folder's own note of its experiment.
const FILE: &str = "experiment.toml";

/// What all trainings of an experiment share.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Experiment {
    /// The first seed.
    pub seed: u64,
    /// How many seeds.
    pub seeds: u32,
    /// Steps of each training.
    pub steps: u64,
    /// Episodes of the evaluation after each block.
    pub eval_episodes: u64,
}

impl Experiment {
    /// The experiment that is asked for, and its folder. With `--resume` it is
    /// the one in the folder; it may become longer or get more seeds, anything
    /// else would be another one.
    ///
    /// # Errors
    /// When the folder holds another experiment, or none where one is gone on
    /// with, or cannot be read.
    pub fn open(arguments: &Train) -> anyhow::Result<(Experiment, PathBuf)> {
        let out = folder(arguments);
        let begun = Experiment::read(&out)?;
        let asked = match (begun, arguments.resume) {
            (Some(_), false) => bail!(
                "{}: holds an experiment; --resume goes on with it, --out DIR begins another",
                out.display()
            ),
            (None, true) => bail!(
                "{}: there is nothing to go on with; without --resume an experiment begins there",
                out.display()
            ),
            (None, false) => Experiment {
                seed: arguments.seed.unwrap_or(0),
                seeds: arguments.seeds.unwrap_or(1),
                steps: arguments.steps.unwrap_or(STEPS),
                eval_episodes: arguments.eval_episodes.unwrap_or(EVAL_EPISODES),
            },
            (Some(begun), true) => begun.gone_on_with(arguments, &out)?,
        };
        Ok((asked, out))
    }

    /// Notes it in its folder.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn write(&self, out: &Path) -> anyhow::Result<()> {
        fs::create_dir_all(out).with_context(|| out.display().to_string())?;
        let file = out.join(FILE);
        fs::write(&file, toml::to_string(self)?).with_context(|| file.display().to_string())
    }

    /// Its seeds.
    pub fn all_seeds(&self) -> Range<u64> {
        self.seed..self.seed.saturating_add(u64::from(self.seeds))
    }

    fn gone_on_with(self, arguments: &Train, out: &Path) -> anyhow::Result<Experiment> {
        let asked = Experiment {
            seed: arguments.seed.unwrap_or(self.seed),
            seeds: arguments.seeds.unwrap_or(self.seeds),
            steps: arguments.steps.unwrap_or(self.steps),
            eval_episodes: arguments.eval_episodes.unwrap_or(self.eval_episodes),
        };
        let is_same = asked.seed == self.seed
            && asked.seeds >= self.seeds
            && asked.steps >= self.steps
            && asked.eval_episodes == self.eval_episodes;
        if !is_same {
            bail!(
                "{}: holds --seed {} --seeds {} --steps {} --eval-episodes {}; it can only get \
                 more seeds or steps; leave the options out to go on as begun, --out DIR begins \
                 another experiment",
                out.display(),
                self.seed,
                self.seeds,
                self.steps,
                self.eval_episodes
            );
        }
        Ok(asked)
    }

    /// What a folder holds; `None` when it holds no experiment. A folder with
    /// seeds and no note holds these seeds.
    fn read(out: &Path) -> anyhow::Result<Option<Experiment>> {
        let file = out.join(FILE);
        if file.exists() {
            let text = fs::read_to_string(&file).with_context(|| file.display().to_string())?;
            let held = toml::from_str(&text).with_context(|| file.display().to_string())?;
            return Ok(Some(held));
        }
        let seeds = seed_folders(out)?;
        let (Some((first, _)), Some((last, _))) = (seeds.first(), seeds.last()) else {
            return Ok(None);
        };
        Ok(Some(Experiment {
            seed: *first,
            seeds: u32::try_from(last - first + 1).context("seeds")?,
            steps: STEPS,
            eval_episodes: EVAL_EPISODES,
        }))
    }
}

/// The folder that is meant.
pub fn folder(arguments: &Train) -> PathBuf {
    arguments.out.clone().unwrap_or_else(|| {
        let name = format!("train-{}", arguments.algorithm.word());
        Path::new("runs").join(name)
    })
}
