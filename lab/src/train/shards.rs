//! Trainings in parts. A piece is the training of one seed.
//!
//! A training that is interrupted and resumed goes on with other episodes than one that
//! is not, so that its policy is another one. For the figures of one piece, bit by bit,
//! an interrupted training of a part begins again; what it had trained is removed. A
//! training whose evaluations alone were interrupted goes on.

use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;
use std::{fs, io};

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize};
use shm_config::counted;
use shm_config::run::RunPaths;
use supervisor::machine::signals::pause;
use supervisor::run::leftovers::{Cleaned, clean_run};
use supervisor::subcommand::{say, write_json_option};

use super::arguments::Train;
use super::experiment::{self, Experiment};
use super::protocol::Protocol;
use super::results::{self, FinalSeeds, Results, Seed, policy_file};
use super::training::{self, End};
use super::{evaluator, report_folder, tell, write};
use crate::report::hex;
use crate::sections::EPISODES;
use crate::shard::Shard;
use crate::shard::folder::ShardWork;
use crate::shard::merge::{Merged, Partial, is_sharded, missing_parts, tell_other_training};
use crate::shard::terms::Terms;
use crate::stop::Stop;
use stack::Clock;

/// The unit of the pieces.
const UNIT: &str = "training";
/// Interval and number of checks whether the process set of a killed training has ended: it
/// notices within a second.
const LOOK: Duration = Duration::from_millis(100);
const LOOKS: u32 = 300;

/// A finished training in the file of a part; its results are in its folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrainingResult {
    seed: u64,
    /// SHA-256 of the last policy, hexadecimal: a folder that is copied in part differs.
    policy_sha256: String,
}

impl TrainingResult {
    /// Of a training whose folder is complete; `None` if it is not, or if one of its files
    /// is damaged, of which a line is printed.
    ///
    /// # Errors
    /// If a file cannot be read now.
    pub fn of(experiment: &Experiment, (seed, out): (u64, &Path)) -> anyhow::Result<Option<Self>> {
        let folder = out.join(format!("seed-{seed}"));
        let policy = folder.join(policy_file(experiment.steps));
        let found = match Seed::read(seed, folder) {
            Ok(found) => found,
            Err(error) if !is_damage(&error) => return Err(error),
            Err(error) => {
                say(format_args!("{error:#}; the training counts as missing"));
                return Ok(None);
            }
        };
        let is_complete = found.is_complete(experiment.steps, experiment.final_episodes);
        let Some(bytes) = fs::read(policy).ok().filter(|_| is_complete) else {
            return Ok(None);
        };
        Ok(Some(TrainingResult {
            seed,
            policy_sha256: hex(&policy::sha256(&bytes)),
        }))
    }
}

/// Trains the seeds of a part that are left.
///
/// # Errors
/// If the part cannot be worked on, a training fails, or a stop is requested.
pub fn train(arguments: &Train, (shard, out): (Shard, &Path), clock: Clock) -> anyhow::Result<()> {
    let stop = Stop::listen()?;
    let experiment = Experiment::of_shard(arguments, out)?;
    let terms = terms("train", shard, &experiment, out)?;
    let pieces = u64::from(experiment.seeds);
    let _lock = experiment::lock_shared(out)?;
    let label = experiment.algorithm.word();
    let mut work = ShardWork::open::<TrainingResult>(out, shard, &terms, (pieces, label))?;
    experiment.write(out)?;
    work.redo_unless(|piece, result: &TrainingResult| {
        let found = TrainingResult::of(&experiment, (experiment.seed.wrapping_add(piece), out))?;
        Ok(found.as_ref() == Some(result))
    })?;
    if work.was_complete(UNIT) {
        return Ok(());
    }
    for piece in work.left().clone() {
        let seed = experiment.seed.wrapping_add(piece);
        match train_seed(&experiment, (seed, out), &stop, clock)? {
            Some(result) => work.keep(piece, &result)?,
            None => break,
        }
    }
    work.finish(UNIT)
}

/// The terms of an experiment, whichever seeds a part trains.
///
/// # Errors
/// If the configuration is invalid.
pub fn terms(
    command: &str,
    shard: Shard,
    experiment: &Experiment,
    out: &Path,
) -> anyhow::Result<Terms> {
    let mut terms = Terms::new(command, shard);
    terms.add("--algorithm", experiment.algorithm.word());
    terms.add("--steps", experiment.steps);
    terms.add("--seed", experiment.seed);
    terms.add("--seeds", experiment.seeds);
    terms.add("--eval-episodes", experiment.eval_episodes);
    terms.add("--final-episodes", experiment.final_episodes);
    terms.add("--expert", experiment.expert.key());
    terms.add("--world", experiment.world.word());
    // Overrides of other sections may decide too, such as a program of the user's.
    terms.add("--set", experiment.decisive_set().join(" "));
    let protocol = Protocol::new(experiment, (experiment.seed, out))?;
    terms.add_config(&protocol.config)?;
    let run = &toml::Table::try_from(&protocol.config)?["run"];
    for name in EPISODES.into_iter().chain(["shuffle"]) {
        if let Some(value) = run.get(name) {
            terms.add(&format!("run.{name}"), value);
        }
    }
    Ok(terms)
}

/// Trains and evaluates one seed; `None` after a stop request.
///
/// # Errors
/// If the training fails.
pub fn train_seed(
    experiment: &Experiment,
    (seed, out): (u64, &Path),
    stop: &Stop,
    clock: Clock,
) -> anyhow::Result<Option<TrainingResult>> {
    let folder = out.join(format!("seed-{seed}"));
    if folder.exists() && !is_in_one_piece(&folder, experiment.steps)? {
        begin_again(experiment, (seed, out), &folder)?;
    }
    let protocol = Protocol::new(experiment, (seed, out))?;
    if let End::Stopped { .. } = training::train(&protocol, stop, clock)? {
        return Ok(None);
    }
    // The loop of a training starts a second process set where the first one ended early,
    // such as after a restart of its learner.
    if !is_in_one_piece(&folder, experiment.steps)? {
        bail!(
            "{}: was not driven by one process set to its end, so that its policy is another one; \
             the same command trains it again",
            folder.display()
        );
    }
    let seeds = vec![Seed::read(seed, folder.clone())?];
    let watch = (clock, stop);
    let end = evaluator::evaluate_finals(
        experiment,
        &Results { seeds },
        (out, FinalSeeds::Evaluation),
        watch,
    )?;
    if let End::Stopped { .. } = end {
        return Ok(None);
    }
    match TrainingResult::of(experiment, (seed, out))? {
        Some(result) => Ok(Some(result)),
        None => bail!(
            "{}: the training ended, but its results are not complete; the same command tries \
             again",
            folder.display()
        ),
    }
}

/// Whether one process set drove all steps of a training, to its end.
fn is_in_one_piece(folder: &Path, steps: u64) -> anyhow::Result<bool> {
    let named = || folder.display().to_string();
    let mut summaries = Vec::new();
    for entry in fs::read_dir(folder).with_context(named)? {
        let path = entry.with_context(named)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with("summary-") && name.ends_with(".json") {
            summaries.push(path);
        }
    }
    let [summary] = &summaries[..] else {
        return Ok(false);
    };
    let bytes = fs::read(summary).with_context(named)?;
    let summary: serde_json::Value = serde_json::from_slice(&bytes).unwrap_or_default();
    match results::block_evaluations(folder).and_then(|_| results::steps(folder)) {
        Ok(driven) => Ok(summary["ended"] == "finished" && driven == steps),
        Err(error) if is_damage(&error) => Ok(false),
        Err(error) => Err(error),
    }
}

/// Whether a file was read and has another content than a training writes. A file that
/// cannot be read now may be whole.
fn is_damage(error: &anyhow::Error) -> bool {
    let error = error.downcast_ref::<io::Error>();
    error.is_none_or(|error| error.kind() == io::ErrorKind::InvalidData)
}

/// Removes the folder of an interrupted training, after its process set has ended: that of
/// a killed process may live for a moment longer.
fn begin_again(
    experiment: &Experiment,
    (seed, out): (u64, &Path),
    folder: &Path,
) -> anyhow::Result<()> {
    // The configuration within may not be read: it may be incomplete.
    let name = super::protocol::run_name(out, seed);
    let paths = RunPaths::new(name.parse()?);
    let mut looks = 0;
    while let Cleaned::Alive = clean_run(&paths)? {
        looks += 1;
        if looks > LOOKS {
            bail!(
                "{}: a process set of this training still drives; ./vlaps down --run {name} stops \
                 it",
                folder.display()
            );
        }
        pause(LOOK);
    }
    let trained = results::steps(folder).unwrap_or(0);
    if trained > 0 {
        say(format_args!(
            "seed {seed}: was interrupted after {trained} of {}; it begins again",
            counted(experiment.steps, "step")
        ));
    }
    fs::remove_dir_all(folder).with_context(|| folder.display().to_string())
}

/// Reports the trainings in a folder; of a folder with parts the complete ones, and what is
/// missing. Exit code 1: something is missing.
///
/// # Errors
/// If the folder holds no training, or parts of different work.
pub fn report(arguments: &Train, out: &Path) -> anyhow::Result<ExitCode> {
    if !is_sharded(out)? {
        report_folder(arguments, out)?;
        return Ok(ExitCode::SUCCESS);
    }
    let merged = Merged::<TrainingResult>::read(out, "train")?;
    let experiment = Experiment::read(out)?;
    let experiment = experiment.with_context(|| out.display().to_string())?;
    merged.check_pieces(u64::from(experiment.seeds))?;
    let mut seeds = Vec::new();
    let missing = merged.missing_unless(|piece, result| {
        let seed = experiment.seed.wrapping_add(piece);
        let found = TrainingResult::of(&experiment, (seed, out))?;
        if found.as_ref() != Some(result) {
            let folder = out.join(format!("seed-{seed}"));
            tell_other_training(&folder);
            return Ok(false);
        }
        seeds.push(Seed::read(seed, out.join(format!("seed-{seed}")))?);
        Ok(true)
    })?;
    let results = Results { seeds };
    if !results.seeds.is_empty() {
        write(out, &results)?;
        tell(out, &results);
    }
    let figures = results.summary();
    let Some(missing) = missing_parts(&missing) else {
        write_json_option(&arguments.json, &figures)?;
        return Ok(ExitCode::SUCCESS);
    };
    missing.tell(&merged.header, UNIT);
    write_json_option(&arguments.json, &Partial { figures, missing })?;
    Ok(ExitCode::from(1))
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use supervisor::subcommand::Program;

    use super::*;
    use crate::Command;

    fn terms_of(words: &[&str]) -> Terms {
        let begin = ["vlaps", "train", "--seeds", "2", "--out", "/nowhere/out"];
        let words = [&begin[..], words].concat();
        let parsed = Program::<Command>::try_parse_from(words).expect("a command");
        let Command::Train(arguments) = parsed.command else {
            panic!("another command");
        };
        let (shard, out) = (Shard { number: 1, of: 2 }, Path::new("/nowhere/out"));
        let experiment = Experiment::of_shard(&arguments, out).expect("an experiment");
        terms("train", shard, &experiment, out).expect("terms")
    }

    #[test]
    fn a_damaged_summary_is_trained_again_and_one_that_cannot_be_read_is_an_error() {
        let folder = tempfile::tempdir().expect("a folder");
        let is_whole = || is_in_one_piece(folder.path(), 0).map_err(|error| error.to_string());
        assert_eq!(is_whole(), Ok(false), "no summary");
        let summary = folder.path().join("summary-1.json");
        for (bytes, expected) in [
            (&b"{\"ended\":\"finished\"}"[..], true),
            (b"{\"ended\":\"stopped\"}", false),
            (b"{\"ended\":\"fin", false),
            (b"{\"ended\":\"finished\xff\"}", false),
            (b"", false),
        ] {
            fs::write(&summary, bytes).expect("a file");
            assert_eq!(is_whole(), Ok(expected), "{}", bytes.escape_ascii());
        }
        fs::remove_file(&summary).expect("it is there");
        fs::create_dir(&summary).expect("a folder in its place");
        assert!(is_whole().is_err());
    }

    #[test]
    fn a_part_with_another_override_is_of_another_training() {
        let begun = terms_of(&["--set", "run.seeds=20"]);
        assert_eq!(
            begun.difference(&terms_of(&["--set", "run.seeds=20"])),
            None
        );
        for (other, hint) in [
            ("run.seeds=40", "run.seeds 20, not 40"),
            ("run.seed=7", "run.seed 100, not 7"),
            ("run.shuffle=9", "run.shuffle 1, not 9"),
            (
                "limits.command_age_ms=400",
                "limits.command_age_ms 250.0, not 400.0",
            ),
            ("deadlines.planner=skip", "deadlines.planner"),
            ("supervisor.silence_s=70", "--set run.seeds=20, not"),
        ] {
            let asked = match other.starts_with("run.seeds=") {
                true => terms_of(&["--set", other]),
                false => terms_of(&["--set", "run.seeds=20", "--set", other]),
            };
            let words = begun.difference(&asked).expect(other);
            assert!(words.contains(hint), "{other}: {words}");
        }
        // How long a slower machine waits decides nothing.
        let slower = ["run.seeds=20", "limits.lockstep_wait_s=300"];
        let slower = terms_of(&["--set", slower[0], "--set", slower[1]]);
        assert_eq!(begun.difference(&slower), None);
    }
}
