//! `./vlaps relearn`: policies trained anew on what trainings recorded.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, anyhow, bail};
use clap::Args;
use learner::relearn::Relearning;
use shm_config::config::Config;
use shm_config::counted;
use shm_config::file::{Durable, check_writable, replace};
use stack::Clock;
use supervisor::cli::failure::Failure;
use supervisor::cli::parsers::whole;
use supervisor::subcommand::{Output, Subcommand, say, settings};
use toml::Table;

use crate::fork::cannot;
use crate::progress::Progress;
use crate::stop::Stop;
use crate::train::results::{CONFIG, seed_folders};

/// The file beside each training's own policies.
const POLICY: &str = "relearnt.onnx";

/// Number of progress lines.
const PARTS: u64 = 20;

/// Train a policy anew on what the replay of a training holds: steps and imagined scenes.
#[derive(Debug, Args)]
#[command(
    after_help = "While a training drives, its first steps are learnt from many times and its last \
        ones hardly at all. Trained from scratch on the whole replay, a policy sees all of them \
        equally often; the rate falls over the updates. Nothing is driven and no expert is \
        asked. All cores compute; their number changes no bit. A replay holds the newest \
        learner.capacity transitions of each kind (steps that prefer the expert, other steps, \
        imagined scenes), with the capacity of its training: a larger one here brings back nothing \
        that was dropped.\n\n\
        The policy of each seed is written to seed-N/relearnt.onnx, when it is complete. A seed \
        that has one is left out, even if other settings made it; --again replaces it. With \
        --together, one policy learns from all of them. The settings are those of the training, of \
        the first one with --together, unless --set says otherwise, such as another algorithm or \
        another size of the network. What was decided while driving stays, such as \
        learner.imagined_scenes.\n\n\
        Exit code 2: a folder holds no training, or an option is wrong.\n\n\
        Examples:\n  \
        ./vlaps relearn runs/train-ppl\n  \
        ./vlaps relearn runs/train-ppl --updates 60000 --set learner.hidden=512 --again\n  \
        ./vlaps relearn runs/train-ppl/seed-0 --set learner.algorithm=dagger\n  \
        ./vlaps relearn runs/a runs/b --together both.onnx --set learner.capacity=1000000\n  \
        ./vlaps eval --driver runs/train-ppl/seed-0/relearnt.onnx"
)]
pub struct Relearn {
    /// Folders of experiments, as `./vlaps train` makes them, or of single seeds.
    #[arg(value_name = "DIR", required = true)]
    pub folders: Vec<PathBuf>,
    /// Train one policy on all of them together, and write it to this file.
    #[arg(long, value_name = "FILE")]
    pub together: Option<PathBuf>,
    /// Number of updates, over which the rate falls to a hundredth.
    #[arg(long, value_name = "N", default_value_t = 30_000, allow_negative_numbers = true,
          value_parser = whole::<u32>(1..=100_000_000))]
    pub updates: u32,
    /// Replace policies that are there.
    #[arg(long)]
    pub again: bool,
    /// Override a key of the training's configuration, such as learner.batch=1024; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
}

impl Subcommand for Relearn {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::File("--together", self.together.clone())]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let watch = (&Stop::listen()?, clock);
        let seeds = self.seeds()?;
        if let Some(file) = &self.together {
            if file.exists() && !self.again {
                let what = format!("{}: is there; --again replaces it", file.display());
                return Err(Failure::Usage(what).into());
            }
            self.relearn(&seeds, file, watch)?;
            say(file.display());
            return Ok(ExitCode::SUCCESS);
        }
        for seed in seeds {
            let file = seed.join(POLICY);
            if file.exists() && !self.again {
                let file = file.display();
                say(format_args!("{file}: is there; --again replaces it"));
                continue;
            }
            self.relearn(&[seed], &file, watch)?;
            say(file.display());
        }
        Ok(ExitCode::SUCCESS)
    }
}

impl Relearn {
    /// The folders of the trainings.
    fn seeds(&self) -> anyhow::Result<Vec<PathBuf>> {
        let mut seeds = Vec::new();
        for folder in &self.folders {
            let refuse = |what: String| Failure::Usage(format!("{}: {what}", folder.display()));
            if !folder.is_dir() {
                return Err(refuse("is no folder".into()).into());
            }
            if folder.join(CONFIG).exists() && folder.join("learner").exists() {
                seeds.push(folder.clone());
                continue;
            }
            let found = seed_folders(folder)?;
            if found.is_empty() {
                let what = format!("holds no training: neither seed-N, nor {CONFIG} and learner/");
                return Err(refuse(what).into());
            }
            seeds.extend(found.into_iter().map(|(_, seed)| seed));
        }
        self.check(&seeds)?;
        Ok(seeds)
    }

    /// What would be found out after hours otherwise: each training is there once, has driven,
    /// and takes its policy.
    fn check(&self, seeds: &[PathBuf]) -> anyhow::Result<()> {
        let mut known = BTreeSet::new();
        for seed in seeds {
            let refuse = |what: String| Failure::Usage(format!("{}: {what}", seed.display()));
            if !known.insert(seed.canonicalize()?) {
                return Err(refuse("is named twice".into()).into());
            }
            if !seed.join("learner/replay.bin").is_file() {
                return Err(refuse("has no learner/replay.bin: nothing was driven".into()).into());
            }
            let file = seed.join(POLICY);
            if self.together.is_none() && (self.again || !file.exists()) {
                if file.is_dir() {
                    return Err(refuse(format!("{POLICY} is a folder")).into());
                }
                check_writable(seed)
                    .map_err(|error| refuse(format!("cannot write there: {error}")))?;
            }
        }
        Ok(())
    }

    /// The configuration of the first training with the overrides.
    fn configuration(&self, seeds: &[PathBuf]) -> anyhow::Result<Config> {
        let first = seeds.first().context("no training")?;
        let mut config = changed(first, &self.overrides)?;
        config.learner.decay_updates = self.updates;
        let mut told = Vec::new();
        for seed in seeds {
            told.push(changed(seed, &[])?.learner.motion);
        }
        let is_said = says_motion(&self.overrides);
        // The first training does not decide for those that were told more.
        let wants = config.learner.motion || (!is_said && told.contains(&true));
        if let Some((seed, _)) = seeds.iter().zip(told).find(|(_, told)| wants && !told) {
            bail!(
                "{}: was trained without learner.motion, so its replay does not tell how bodies \
                 move: learn without this training, or from all of them with --set \
                 learner.motion=false",
                seed.display()
            );
        }
        Ok(config)
    }

    /// Trains one policy on these trainings and writes it to the file.
    fn relearn(
        &self,
        seeds: &[PathBuf],
        file: &Path,
        (stop, clock): (&Stop, Clock),
    ) -> anyhow::Result<()> {
        let config = self.configuration(seeds).map_err(cannot)?;
        let commit = std::env::var("VLAPS_COMMIT").unwrap_or_default();
        let learners: Vec<PathBuf> = seeds.iter().map(|seed| seed.join("learner")).collect();
        let opened = Relearning::open(&config, &learners, commit);
        let mut relearning = opened.map_err(|error| cannot(error.into()))?;
        let name = match seeds {
            [_] => format!("seed {}", config.learner.seed),
            seeds => format!("{} trainings", seeds.len()),
        };
        let total = u64::from(self.updates);
        let mut progress = Progress::begin(name, "updates", (0, total), clock)?;
        let transitions = counted(relearning.transitions() as u64, "transition");
        progress.tell(&format!("learns from {transitions}"));
        let left_out = relearning.left_out();
        if left_out > 0 {
            progress.warn(&format!(
                "{} that were read first are left out: learner.capacity is {} of each kind",
                counted(left_out, "transition"),
                config.learner.capacity
            ));
        }
        let part = (total / PARTS).max(1);
        let mut loss = 0.0;
        for update in 1..=total {
            if stop.is_asked() {
                progress.end();
                bail!(
                    "stopped after {} of {total} updates; nothing was written",
                    update - 1
                );
            }
            loss += relearning.update().actor;
            if update.is_multiple_of(part) {
                progress.note(format!("loss {:.4}", loss / part as f32));
                progress.at(update);
                loss = 0.0;
            }
        }
        progress.end();
        let policy = relearning.policy_file()?;
        replace(file, &policy, Durable::Yes).with_context(|| file.display().to_string())
    }
}

/// The configuration of a training with the overrides.
fn changed(seed: &Path, overrides: &[String]) -> anyhow::Result<Config> {
    let file = seed.join(CONFIG);
    let name = |error: anyhow::Error| anyhow!("{}: {error:#}", file.display());
    let text = fs::read_to_string(&file).map_err(|error| name(error.into()))?;
    settings::changed(&text, &[]).map_err(name)?;
    settings::changed(&text, overrides)
}

/// Whether overrides decide on `learner.motion`: as a key of its own, or with the section, since
/// a whole section sets all its keys.
fn says_motion(overrides: &[String]) -> bool {
    overrides.iter().any(|text| {
        let given: Table = text.parse().unwrap_or_default();
        let section = given.get("learner");
        section.is_some_and(|section| {
            settings::key(text) == "learner" || section.get("motion").is_some()
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overrides_decide_on_motion_by_key_or_section() {
        let says = |text: &str| says_motion(&["learner.batch=64".into(), text.into()]);
        assert!(says("learner.motion=false"));
        assert!(says(" learner.motion = true"));
        assert!(says("learner={motion=true}"));
        assert!(says("learner={batch=32}"));
        assert!(!says("learner.batch=32"));
        assert!(!says("mpc.wary=false"));
    }
}
