//! `./vlaps train`: the paper's experiment (Sec. 5), on the real process set.
//!
//! | module | holds |
//! |---|---|
//! | [`protocol`] | the experiment's numbers, as configuration |
//! | [`student`] | one training: the process set in lockstep, watched |
//! | [`examiner`] | 50 episodes without intervention after every block |
//! | [`results`] | what the folders hold, read back |
//! | [`curves`] | Figure 4, as SVG and PNG |
//! | [`table`] | Table 1, and the mean over seeds |
//! | [`tensorboard`] | the same numbers as an event file |
//!
//! Everything is in the folder, and everything printed is computed from it: an
//! interrupted experiment goes on with `--resume`, a finished one is only
//! reported again.

pub mod curves;
pub mod examiner;
pub mod protocol;
pub mod results;
pub mod student;
pub mod table;
pub mod tensorboard;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

use crate::Clock;
use crate::arguments::Train;
use crate::report::{say, write_json};
use protocol::Protocol;
use results::Results;

/// Trains with every seed asked for, and reports.
///
/// # Errors
/// When the configuration is wrong, a folder holds another experiment, or the
/// process set gives up.
pub fn train(arguments: &Train, clock: Clock) -> anyhow::Result<()> {
    let out = folder(arguments)?;
    for seed in arguments.seed..arguments.seed.saturating_add(u64::from(arguments.seeds)) {
        let protocol = Protocol::new(arguments, seed, &out)?;
        match student::train(&protocol, clock)? {
            student::End::Complete => {}
            student::End::Stopped { steps } => {
                say(format_args!(
                    "stopped after {steps} steps of seed {seed}; the same command with --resume goes on"
                ));
                break;
            }
        }
        report(arguments, &out)?;
    }
    let results = Results::read(&out)?;
    if results.seeds.is_empty() {
        bail!("{}: nothing was learnt yet", out.display());
    }
    examiner::examine_finals(arguments, &results, &out, clock)?;
    let results = report(arguments, &out)?;
    say(table::blocks(&results));
    if let Some(finals) = table::finals(&results) {
        say(finals);
    }
    if let Some(path) = &arguments.json {
        write_json(path, &results.summary())?;
    }
    say(format_args!(
        "{}: curves.svg, curves.png, table.md, policy.onnx (the best), seed-*/",
        out.display()
    ));
    Ok(())
}

/// Pictures, tables and the best policy, from what the folders hold.
fn report(arguments: &Train, out: &Path) -> anyhow::Result<Results> {
    let results = Results::read(out)?;
    if results.seeds.is_empty() {
        return Ok(results);
    }
    curves::draw(&results, arguments.algorithm.word(), out)?;
    tensorboard::write(&results, out)?;
    fs::write(out.join("table.md"), table::markdown(&results)).context("table.md")?;
    if let Some(best) = results.best() {
        fs::copy(&best, out.join("policy.onnx")).with_context(|| format!("{}", best.display()))?;
    }
    Ok(results)
}

/// The experiment's folder. One that is there is another experiment's, or is
/// gone on with.
fn folder(arguments: &Train) -> anyhow::Result<PathBuf> {
    let out = arguments.out.clone().unwrap_or_else(|| {
        let name = format!("train-{}", arguments.algorithm.word());
        Path::new("runs").join(name)
    });
    let holds = out.join(format!("seed-{}", arguments.seed)).exists();
    if holds && !arguments.resume {
        bail!(
            "{}: holds an experiment; --resume goes on with it, --out DIR begins another",
            out.display()
        );
    }
    if arguments.resume && !out.exists() {
        bail!(
            "{}: there is nothing to go on with; without --resume an experiment begins there",
            out.display()
        );
    }
    fs::create_dir_all(&out).with_context(|| format!("{}", out.display()))?;
    Ok(out)
}
