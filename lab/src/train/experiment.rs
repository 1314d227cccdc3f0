//! Which experiment a folder holds: the options it was begun with.

use std::fs::{self, File, TryLockError};
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize};
use shm_config::config::{Algorithm, text_of};
use shm_config::file::read_text;
use supervisor::cli::failure::Failure;
use supervisor::commands::up::settings::DEFAULT_FILE;

use super::arguments::{ExpertChoice, Train};
use super::results::seed_folders;
use supervisor::commands::up::arguments::WorldChoice;
use supervisor::subcommand::settings::key;

/// The folder's own note of its experiment.
const FILE: &str = "experiment.toml";
/// Largest such file, bytes: a hundred times one with every option.
const BYTES_MAX: u64 = 1 << 20;
/// The configuration file as it was when the experiment began; empty without one.
const CONFIG: &str = "config.toml";
/// Locked by the process that trains in the folder; the kernel drops the lock.
const LOCK: &str = ".lock";

/// What all trainings of an experiment share. What the note of an older version
/// lacks is as by default, and has to be given again.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Experiment {
    /// The first seed.
    pub seed: u64,
    /// How many seeds.
    pub seeds: u32,
    /// Steps of each training.
    pub steps: u64,
    /// Episodes of the evaluation after each block.
    pub eval_episodes: u64,
    /// Episodes of the evaluation of each last policy; 0 for none.
    pub final_episodes: u64,
    /// How it learns.
    pub algorithm: Algorithm,
    /// Whom it learns from.
    pub expert: ExpertChoice,
    /// In which world it is trained.
    pub world: WorldChoice,
    /// Overrides of the configuration, `KEY=VALUE`.
    pub set: Vec<String>,
    /// The configuration file, if there is one.
    #[serde(skip)]
    pub config: Option<PathBuf>,
}

impl Default for Experiment {
    /// The paper's numbers (Sec. 5), but for the last policy, which it evaluates no
    /// further, and the expert.
    fn default() -> Experiment {
        Experiment {
            seed: 0,
            seeds: 1,
            steps: 50_000,
            eval_episodes: 50,
            final_episodes: 1000,
            algorithm: Algorithm::Pvp,
            expert: ExpertChoice::Mpc,
            world: WorldChoice::Sim,
            set: Vec::new(),
            config: None,
        }
    }
}

impl Experiment {
    /// The experiment that is asked for, and its folder, of which nothing is
    /// touched. With `--resume` it is the one in the folder; it may become longer or
    /// get more seeds, anything else would be another one.
    ///
    /// # Errors
    /// When the folder holds another experiment or other files, or none where
    /// one is gone on with, or cannot be read.
    pub fn open(arguments: &Train) -> anyhow::Result<(Experiment, PathBuf)> {
        let out = folder(arguments);
        let begun = Experiment::read(&out)?;
        match (&begun, arguments.resume) {
            (Some(_), false) => bail!(
                "{}: holds an experiment; --resume continues it, --out DIR begins another",
                out.display()
            ),
            (None, true) => bail!(
                "{}: there is nothing to go on with; without --resume an experiment begins there",
                out.display()
            ),
            (None, false) => check_free(&out)?,
            (Some(_), true) => {}
        }
        let asked = begun.clone().unwrap_or_default().with(arguments, &out);
        if let Some(begun) = begun {
            begun.check_goes_on(&asked, &out)?;
        }
        Ok((asked, out))
    }

    /// What a folder holds; `None` when it holds no experiment. A folder with
    /// seeds and no note holds these seeds.
    ///
    /// # Errors
    /// When the folder or its note cannot be read.
    pub fn read(out: &Path) -> anyhow::Result<Option<Experiment>> {
        let file = out.join(FILE);
        if file.exists() {
            let text = read_text(&file, BYTES_MAX).with_context(|| file.display().to_string())?;
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
            ..Experiment::default()
        }))
    }

    /// Notes it in its folder, which is held.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn write(&self, out: &Path) -> anyhow::Result<()> {
        let config = self.config.as_deref().map(text_of).transpose()?;
        let note = toml::to_string(self)?;
        for (file, text) in [(CONFIG, config.unwrap_or_default()), (FILE, note)] {
            let file = out.join(file);
            fs::write(&file, text).with_context(|| file.display().to_string())?;
        }
        Ok(())
    }

    /// Its seeds.
    pub fn all_seeds(&self) -> Range<u64> {
        self.seed..self.seed.saturating_add(u64::from(self.seeds))
    }

    /// With what the command line says; the rest stays.
    fn with(self, arguments: &Train, out: &Path) -> Experiment {
        let chosen = &arguments.configuration;
        let given = &chosen.overrides;
        let is_given = |held: &String| given.iter().any(|text| key(text) == key(held));
        let mut set = self.set;
        set.retain(|held| !is_given(held));
        set.extend(given.iter().cloned());
        // An experiment continues with its own file, not with one of the current folder.
        let others = [out.join(CONFIG), DEFAULT_FILE.into()].into_iter();
        let other = || others.clone().find(|file| file.symlink_metadata().is_ok());
        Experiment {
            seed: arguments.seed.unwrap_or(self.seed),
            seeds: arguments.seeds.unwrap_or(self.seeds),
            steps: arguments.steps.unwrap_or(self.steps),
            eval_episodes: arguments.eval_episodes.unwrap_or(self.eval_episodes),
            final_episodes: arguments.final_episodes.unwrap_or(self.final_episodes),
            algorithm: arguments.algorithm.unwrap_or(self.algorithm),
            expert: arguments.expert.unwrap_or(self.expert),
            world: arguments.world.unwrap_or(self.world),
            set,
            config: chosen.config.clone().or_else(other),
        }
    }

    /// Of what decides what is learnt, each training's own configuration tells
    /// (`Protocol::new`).
    fn check_goes_on(&self, asked: &Experiment, out: &Path) -> anyhow::Result<()> {
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
        Ok(())
    }
}

/// The folder that is meant.
pub fn folder(arguments: &Train) -> PathBuf {
    arguments.out.clone().unwrap_or_else(|| {
        let default = Experiment::default().algorithm;
        let algorithm = arguments.algorithm.unwrap_or(default);
        Path::new("runs").join(format!("train-{}", algorithm.word()))
    })
}

/// Makes the folder if it is missing, and holds it until the file is dropped or the
/// process ends, in any way: no other process trains there meanwhile.
///
/// # Errors
/// When another process does, or the folder cannot be made.
pub fn hold(out: &Path) -> anyhow::Result<File> {
    fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let path = out.join(LOCK);
    let named = || path.display().to_string();
    let mut options = File::options();
    let file = options.write(true).create(true).truncate(false);
    let file = file.open(&path).with_context(named)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => bail!(
            "{}: is being trained in by another ./vlaps train; stop that first, or train \
             elsewhere with --out DIR",
            out.display()
        ),
        Err(TryLockError::Error(error)) => Err(error).with_context(named),
    }
}

/// An experiment may begin in a folder that is missing or empty: in any other it
/// would replace files of the same names. A lock alone is of one that was killed
/// before it had begun.
fn check_free(out: &Path) -> anyhow::Result<()> {
    let entries = match fs::read_dir(out) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error).with_context(|| out.display().to_string()),
    };
    for entry in entries {
        let name = entry?.file_name();
        if name != LOCK {
            let message = format!(
                "--out {}: holds {} and no experiment, whose files might replace what is there; \
                 name a new or an empty folder",
                out.display(),
                name.display()
            );
            return Err(Failure::Usage(message).into());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use supervisor::subcommand::Program;

    use crate::Command;

    fn open(out: &Path, words: &[&str]) -> anyhow::Result<Experiment> {
        let begin = ["vlaps", "train", "--out", out.to_str().expect("UTF-8")];
        let words = [&begin[..], words].concat();
        match Program::<Command>::try_parse_from(words)?.command {
            Command::Train(arguments) => Ok(Experiment::open(&arguments)?.0),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn what_is_not_given_with_resume_is_as_it_was_begun() {
        let place = tempfile::tempdir().expect("a folder");
        let (out, file) = (place.path().join("out"), place.path().join("own.toml"));
        fs::write(&file, "[learner]\nbatch = 64\n").expect("a file");
        let words = "--algorithm hg-dagger --expert informed --steps 400 --final-episodes 0 \
                     --set learner.updates=20 --set learner.hidden=32 --config";
        let mut words: Vec<&str> = words.split_whitespace().collect();
        words.push(file.to_str().expect("UTF-8"));
        let begun = open(&out, &words).expect("an experiment");
        let _held = hold(&out).expect("the folder");
        begun.write(&out).expect("a note");
        // The user's file may change; the experiment has its own.
        fs::write(&file, "[learner]\nbatch = 128\n").expect("a file");
        let own = fs::read_to_string(out.join(CONFIG)).expect("its own");
        assert!(own.contains("batch = 64"), "{own}");

        let gone_on = open(&out, &["--resume"]).expect("the same");
        let config = Some(out.join(CONFIG));
        assert_eq!(gone_on, Experiment { config, ..begun });
        let words = ["--resume", "--set", "learner.updates=30"];
        let other = open(&out, &words).expect("the note tells of no configuration");
        assert_eq!(other.set, ["learner.hidden=32", "learner.updates=30"]);
    }

    #[test]
    fn an_older_note_is_completed_with_what_is_given() {
        let out = tempfile::tempdir().expect("a folder");
        let note = "seed = 3\nseeds = 2\nsteps = 400\neval_episodes = 2\n";
        fs::write(out.path().join(FILE), note).expect("a note");
        let words = ["--resume", "--algorithm", "bc"];
        let experiment = open(out.path(), &words).expect("an experiment");
        assert_eq!(experiment.all_seeds(), 3..5);
        assert_eq!((experiment.steps, experiment.eval_episodes), (400, 2));
        assert_eq!(experiment.algorithm, Algorithm::Bc);
        assert_eq!(experiment.expert, ExpertChoice::Mpc);
    }
}
