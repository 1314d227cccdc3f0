//! The options of an experiment, stored in its folder.

use std::fs::{self, File, TryLockError};
use std::ops::Range;
use std::path::{Path, PathBuf, absolute};

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize};
use shm_config::config::{Algorithm, Simulator, text_of, vehicle_of};
use shm_config::file::{Durable, read_text, replace};
use shm_config::run::RunName;
use supervisor::cli::failure::Failure;
use supervisor::commands::up::settings::DEFAULT_FILE;

use super::arguments::{ExpertChoice, Train};
use super::results::seed_folders;
use crate::sections::WAITS;
use crate::shard::holds_shards;
use crate::shard::merge::is_sharded;
use supervisor::subcommand::settings::{self, key};

/// File with the options of the experiment.
const FILE: &str = "experiment.toml";
/// Maximum size of that file, bytes: a hundred times that of a file with every option.
const BYTES_MAX: u64 = 1 << 20;
/// Copy of the configuration file at the begin of the experiment; empty without one.
const CONFIG: &str = "config.toml";
/// Locked by the process that trains in the folder; the kernel releases the lock.
const LOCK: &str = ".lock";

/// Options shared by all trainings of an experiment. Options that are missing in the file
/// of an older version get their defaults and must be given again.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Experiment {
    /// The first seed.
    pub seed: u64,
    /// Number of seeds.
    pub seeds: u32,
    /// Steps per training.
    pub steps: u64,
    /// Episodes of the evaluation after each block.
    pub eval_episodes: u64,
    /// Episodes of the evaluation of each last policy; 0 for none.
    pub final_episodes: u64,
    /// Algorithm.
    pub algorithm: Algorithm,
    /// The expert to learn from.
    pub expert: ExpertChoice,
    /// The world to train in.
    pub world: Simulator,
    /// Actors on this machine; none for a training that a process set drives. Their number
    /// may change.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actors: Option<u32>,
    /// Where actors of other machines join.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actors_at: Option<String>,
    /// The run that has invited them; none for the default one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actors_run: Option<String>,
    /// Overrides of the configuration, `KEY=VALUE`.
    pub set: Vec<String>,
    /// The configuration file, if there is one.
    #[serde(skip)]
    pub config: Option<PathBuf>,
}

impl Default for Experiment {
    /// The paper's numbers (Sec. 5), except for the expert and for the final evaluation, which
    /// the paper does not have.
    fn default() -> Experiment {
        Experiment {
            seed: 0,
            seeds: 1,
            steps: 50_000,
            eval_episodes: 50,
            final_episodes: 1000,
            algorithm: Algorithm::Pvp,
            expert: ExpertChoice::Mpc,
            world: Simulator::BuiltIn,
            actors: None,
            actors_at: None,
            actors_run: None,
            set: Vec::new(),
            config: None,
        }
    }
}

impl Experiment {
    /// The requested experiment and its folder; no file is changed. With `--resume` it is the
    /// experiment in the folder; it may get more steps or seeds, but no other changes.
    ///
    /// # Errors
    /// If the folder contains another experiment or other files, contains no experiment
    /// to resume, or cannot be read; if the configuration or an override is invalid.
    pub fn open(arguments: &Train) -> anyhow::Result<(Experiment, PathBuf)> {
        let out = folder(arguments);
        let begun = Experiment::read(&out)?;
        match (&begun, arguments.resume) {
            (Some(_), false) => bail!(
                "{}: contains an experiment; --resume continues it, --out DIR begins another",
                out.display()
            ),
            (None, true) => bail!(
                "{}: contains no experiment to resume; without --resume one begins there",
                out.display()
            ),
            (None, false) => check_free(&out)?,
            (Some(_), true) => {}
        }
        if is_sharded(&out)? {
            return Err(holds_shards(&out));
        }
        let mut asked = begun.clone().unwrap_or_default().asked(arguments, &out)?;
        asked.keep_policy()?;
        if let Some(begun) = begun {
            begun.check_extends(&asked, &out)?;
        }
        Ok((asked, out))
    }

    /// Names the policy that drives first by its whole path, so that the experiment can be
    /// resumed from another folder.
    fn keep_policy(&mut self) -> anyhow::Result<()> {
        let config = settings::config([self.config.as_deref(), None], &self.set)?;
        let file = config.policy.file;
        if file.is_empty() || Path::new(&file).is_absolute() {
            return Ok(());
        }
        let whole = absolute(&file).with_context(|| file.clone())?;
        let whole = whole.to_str().with_context(|| {
            format!("policy.file = {file:?}: this folder's path is no UTF-8; give a whole path")
        })?;
        let whole = toml::Value::from(whole);
        self.set.retain(|held| key(held) != "policy.file");
        self.set.push(format!("policy.file={whole}"));
        Ok(())
    }

    /// The requested experiment for a part in this folder; no file is changed.
    ///
    /// # Errors
    /// If the folder contains an experiment without parts or other files.
    pub fn of_shard(arguments: &Train, out: &Path) -> anyhow::Result<Experiment> {
        let is_free = match Experiment::read(out)? {
            Some(_) => Err(Failure::Usage(format!(
                "{}: contains an experiment that began without --shard; --resume continues it, \
                 --out DIR begins another",
                out.display()
            ))
            .into()),
            None => check_free(out),
        };
        // Read last: another part may have begun the folder meanwhile.
        if !is_sharded(out)? {
            is_free?;
        }
        Experiment::default().asked(arguments, out)
    }

    /// The requested experiment of a row of a sweep that is done in parts; no file is changed.
    ///
    /// # Errors
    /// If the row was begun without parts, or contains other files.
    pub fn of_row(arguments: &Train, sweep: &Path, row: &Path) -> anyhow::Result<Experiment> {
        if !is_sharded(sweep)? && Experiment::read(row)?.is_some() && !is_sharded(sweep)? {
            return Err(Failure::Usage(format!(
                "{}: contains a sweep that began without --shard; the same command without it \
                 continues, --out DIR begins another",
                sweep.display()
            ))
            .into());
        }
        Experiment::default().asked(arguments, row)
    }

    fn asked(self, arguments: &Train, out: &Path) -> anyhow::Result<Experiment> {
        let given = overrides(arguments)?;
        let asked = self.with(arguments, &given, out);
        if !matches!(asked.world, Simulator::BuiltIn | Simulator::MetaDrive) {
            let world = asked.world.word();
            let line = format!(
                "--world {world}: policies are trained in sim or metadrive, whose tasks are the \
                 same; ./vlaps up and ./vlaps eval drive in {world}"
            );
            return Err(Failure::Usage(line).into());
        }
        if asked.actors == Some(0) && asked.actors_at.is_none() {
            let line = "--actors 0: needs --actors-at HOST:PORT, or at least one actor here";
            return Err(Failure::Usage(line.into()).into());
        }
        Ok(asked)
    }

    /// The experiment in a folder; `None` without one. Seeds in a folder without an options
    /// file count as an experiment with these seeds.
    ///
    /// # Errors
    /// If the folder or the options file cannot be read.
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

    /// Writes the options to the folder, which must be locked.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn write(&self, out: &Path) -> anyhow::Result<()> {
        let config = self.config.as_deref().map(text_of).transpose()?;
        let note = toml::to_string(self)?;
        for (file, text) in [(CONFIG, config.unwrap_or_default()), (FILE, note)] {
            let file = out.join(file);
            // Another part may write the same at this moment.
            replace(&file, text.as_bytes(), Durable::No)
                .with_context(|| file.display().to_string())?;
        }
        Ok(())
    }

    /// The override of the order of the training episodes, if there is one.
    fn shuffle(&self) -> Option<&str> {
        let mut given = self.set.iter().rev();
        let given = given.find(|text| key(text) == "run.shuffle")?;
        given.split_once('=').map(|(_, value)| value.trim())
    }

    /// The overrides that may decide what is learnt.
    pub fn decisive_set(&self) -> Vec<&str> {
        let set = self.set.iter().map(String::as_str);
        set.filter(|text| !WAITS.contains(&key(text))).collect()
    }

    /// The seeds of the trainings.
    pub fn all_seeds(&self) -> Range<u64> {
        self.seed..self.seed.saturating_add(u64::from(self.seeds))
    }

    /// Replaces the options that the command line gives.
    fn with(self, arguments: &Train, given: &[String], out: &Path) -> Experiment {
        let chosen = &arguments.configuration;
        let at = arguments.actors_at.clone().or(self.actors_at);
        let run = arguments.actors_run.as_ref().map(RunName::to_string);
        let is_given = |held: &String| given.iter().any(|text| key(text) == key(held));
        let mut set = self.set;
        set.retain(|held| !is_given(held));
        set.extend(given.iter().cloned());
        // A resumed experiment uses its own copy, not a file of the current folder.
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
            actors: arguments
                .actors
                .or(self.actors)
                .or(at.is_some().then_some(0)),
            actors_at: at,
            actors_run: run.or(self.actors_run),
            set,
            config: chosen.config.clone().or_else(other),
        }
    }

    /// Checks that `asked` extends this experiment. The configuration of each training is
    /// checked by `Protocol::new`, but for the order of its episodes.
    fn check_extends(&self, asked: &Experiment, out: &Path) -> anyhow::Result<()> {
        if self.shuffle() != asked.shuffle() {
            let word = |given: Option<&str>| given.map_or("none", str::trim).to_string();
            bail!(
                "{}: the training began with run.shuffle {}, not {}; leave the override out to \
                 continue unchanged; --out DIR begins another experiment",
                out.display(),
                word(self.shuffle()),
                word(asked.shuffle())
            );
        }
        if self.actors.is_some() != asked.actors.is_some() {
            let (begun, now) = match self.actors {
                Some(_) => ("with", "without"),
                None => ("without", "with"),
            };
            bail!(
                "{}: the training began {begun} --actors, and cannot go on {now}: it would learn \
                 other policies; --out DIR begins another experiment",
                out.display()
            );
        }
        let is_same = asked.seed == self.seed
            && asked.seeds >= self.seeds
            && asked.steps >= self.steps
            && asked.eval_episodes == self.eval_episodes;
        if !is_same {
            bail!(
                "{}: contains --seed {} --seeds {} --steps {} --eval-episodes {}; only more seeds or \
                 more steps are possible; leave the options out to continue unchanged; --out DIR \
                 begins another experiment",
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

/// The overrides that the command line gives: the keys of the vehicle file, so that an
/// experiment is resumed with the car that it began with, then those of `--set`.
fn overrides(arguments: &Train) -> anyhow::Result<Vec<String>> {
    let chosen = &arguments.configuration;
    let vehicle = chosen.vehicle.as_deref().map(vehicle_of).transpose();
    let vehicle = vehicle.map_err(Failure::from)?.unwrap_or_default();
    let keys = vehicle.iter().flat_map(|(section, keys)| {
        let keys = keys.as_table().into_iter().flatten();
        keys.map(move |(key, value)| format!("{section}.{key}={value}"))
    });
    Ok(keys.chain(chosen.overrides.iter().cloned()).collect())
}

/// The folder that the command line names.
pub fn folder(arguments: &Train) -> PathBuf {
    arguments.out.clone().unwrap_or_else(|| {
        let default = Experiment::default().algorithm;
        let algorithm = arguments.algorithm.unwrap_or(default);
        Path::new("runs").join(format!("train-{}", algorithm.word()))
    })
}

/// Creates the folder if it is missing and locks it until the file is dropped or the process
/// ends: no other process can train there meanwhile.
///
/// # Errors
/// If another process holds the lock, or the folder cannot be created.
pub fn lock(out: &Path) -> anyhow::Result<File> {
    lock_with(out, File::try_lock)
}

/// As [`lock`], but shared with other parts of the same experiment.
///
/// # Errors
/// As [`lock`].
pub fn lock_shared(out: &Path) -> anyhow::Result<File> {
    lock_with(out, File::try_lock_shared)
}

fn lock_with(out: &Path, try_lock: fn(&File) -> Result<(), TryLockError>) -> anyhow::Result<File> {
    fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let path = out.join(LOCK);
    let named = || path.display().to_string();
    let mut options = File::options();
    let file = options.write(true).create(true).truncate(false);
    let file = file.open(&path).with_context(named)?;
    match try_lock(&file) {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => bail!(
            "{}: is being trained in by another ./vlaps train; stop that one first, or choose \
             another folder with --out DIR",
            out.display()
        ),
        Err(TryLockError::Error(error)) => Err(error).with_context(named),
    }
}

/// Checks that an experiment may begin in a folder: it is missing or empty. In any other
/// folder it might replace files. A lock file alone is left by a process that was killed
/// at its begin.
fn check_free(out: &Path) -> anyhow::Result<()> {
    let entries = match fs::read_dir(out) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error).with_context(|| out.display().to_string()),
    };
    for entry in entries {
        let name = entry?.file_name();
        let is_lock = name == LOCK || name.to_string_lossy().starts_with(".shard-");
        if !is_lock {
            let message = format!(
                "--out {}: contains {}, but no experiment; a training might replace files there; name \
                 a new or an empty folder",
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
    fn resume_keeps_the_options_that_are_not_given() {
        let place = tempfile::tempdir().expect("a folder");
        let (out, file) = (place.path().join("out"), place.path().join("own.toml"));
        fs::write(&file, "[learner]\nbatch = 64\n").expect("a file");
        let words = "--algorithm hg-dagger --expert informed --steps 400 --final-episodes 0 \
                     --set learner.updates=20 --set learner.hidden=32 --config";
        let mut words: Vec<&str> = words.split_whitespace().collect();
        words.push(file.to_str().expect("UTF-8"));
        let begun = open(&out, &words).expect("an experiment");
        let _lock = lock(&out).expect("the folder");
        begun.write(&out).expect("a note");
        // The user's file may change; the experiment uses its own copy.
        fs::write(&file, "[learner]\nbatch = 128\n").expect("a file");
        let own = fs::read_to_string(out.join(CONFIG)).expect("its own");
        assert!(own.contains("batch = 64"), "{own}");

        let shuffled = ["--resume", "--set", "run.shuffle=7"];
        let error = open(&out, &shuffled)
            .expect_err("another order")
            .to_string();
        assert!(error.contains("run.shuffle none, not 7"), "{error}");
        let gone_on = open(&out, &["--resume"]).expect("the same");
        let config = Some(out.join(CONFIG));
        assert_eq!(gone_on, Experiment { config, ..begun });
        let words = ["--resume", "--set", "learner.updates=30"];
        let other = open(&out, &words).expect("the note tells of no configuration");
        assert_eq!(other.set, ["learner.hidden=32", "learner.updates=30"]);
    }

    #[test]
    fn the_policy_that_drives_first_is_found_from_another_folder() {
        let place = tempfile::tempdir().expect("a folder");
        let (out, file) = (place.path().join("out"), place.path().join("own.toml"));
        fs::write(&file, "[policy]\nfile = \"first.onnx\"\n").expect("a file");
        let here = std::env::current_dir().expect("a folder");
        let kept = |name| {
            let whole = toml::Value::from(here.join(name).to_str().expect("UTF-8"));
            [format!("policy.file={whole}")]
        };
        let by_file = ["--config", file.to_str().expect("UTF-8")];
        assert_eq!(open(&out, &by_file).expect("one").set, kept("first.onnx"));
        let by_key = ["--set", "policy.file=a b.onnx"];
        let begun = open(&out, &by_key).expect("one");
        assert_eq!(begun.set, kept("a b.onnx"));
        let by_section = ["--set", "policy={file=\"a b.onnx\"}"];
        let set = open(&out, &by_section).expect("one").set;
        assert_eq!(set.last(), begun.set.last());
        let _lock = lock(&out).expect("the folder");
        begun.write(&out).expect("a note");
        assert_eq!(open(&out, &["--resume"]).expect("the same").set, begun.set);
        let words = [&["--resume"], &by_key[..]].concat();
        assert_eq!(open(&out, &words).expect("the same").set, begun.set);
    }

    #[test]
    fn an_older_options_file_is_completed_by_the_command_line() {
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
