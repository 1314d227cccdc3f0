//! `./vlaps train`: the paper's experiment (Sec. 5), on the real process set.
//!
//! | module | holds |
//! |---|---|
//! | [`arguments`] | the command line |
//! | [`experiment`] | the stored options of a folder, and the lock of the training process |
//! | [`protocol`] | the experiment's numbers, as configuration |
//! | [`training`] | one training: runs the process set in lockstep |
//! | [`evaluator`] | evaluates 50 episodes without intervention after every block |
//! | [`results`] | reads the results from the folders |
//! | [`shards`] | trainings in parts: `--shard I/N` |
//! | [`warnings`] | warnings about blocks that taught nothing, or whose policy did not drive |
//! | [`curves`] | Figure 4, as SVG and PNG |
//! | [`table`] | Table 1, and the mean over seeds |
//! | [`tensorboard`] | the same numbers as an event file |
//!
//! All results are in the folder, and everything printed is computed from them: `--resume`
//! continues an interrupted experiment and only reports a finished one.

pub mod arguments;
pub mod curves;
pub mod evaluator;
pub mod experiment;
pub mod protocol;
pub mod results;
pub mod shards;
pub mod table;
pub mod tensorboard;
pub mod training;
pub mod warnings;

use std::fs;
use std::path::Path;

use anyhow::{Context, bail};

use crate::fork::cannot;
use crate::stop::Stop;
use arguments::Train;
use experiment::Experiment;
use protocol::Protocol;
use results::{FinalSeeds, Results};
use stack::Clock;
use supervisor::subcommand::{say, write_json_option};
use training::End;

/// Trains with every requested seed and reports the results.
///
/// # Errors
/// If the configuration is invalid, a folder contains another experiment, the process
/// set fails, or a stop is requested.
pub fn train(arguments: &Train, clock: Clock) -> anyhow::Result<()> {
    let stop = Stop::listen()?;
    let (experiment, out) = Experiment::open(arguments)?;
    let protocols: Vec<Protocol> = experiment
        .all_seeds()
        .map(|seed| Protocol::new(&experiment, (seed, &out)))
        .collect::<anyhow::Result<_>>()?;
    if let Some(first) = protocols.first() {
        // A policy or an address that cannot be used leaves no folder.
        training::check_policy(&first.config, clock).map_err(cannot)?;
        drop(training::open_door(first)?);
    }
    let _lock = experiment::lock(&out)?;
    // Stored only after all options are checked, since --resume reuses them.
    experiment.write(&out)?;
    for protocol in &protocols {
        let end = training::train(protocol, &stop, clock)?;
        report(&out)?;
        if let End::Stopped { steps } = end {
            bail!(
                "stopped after {steps} of {} steps of seed {}; the same command with --resume \
                 continues",
                experiment.steps,
                protocol.seed
            );
        }
    }
    let results = Results::read(&out)?;
    let watch = (clock, &stop);
    let mut end = End::Complete;
    for seeds in FinalSeeds::ALL {
        let is_asked = seeds == FinalSeeds::Evaluation || arguments.held_back;
        if is_asked && end == End::Complete {
            end = evaluator::evaluate_finals(&experiment, &results, (&out, seeds), watch)?;
        }
    }
    report_folder(arguments, &out)?;
    match end {
        End::Complete => Ok(()),
        End::Stopped { .. } => bail!(
            "stopped during the evaluation of a last policy; training is complete; the same command \
             with --resume continues"
        ),
    }
}

/// Draws, prints and writes the results of a folder.
fn report_folder(arguments: &Train, out: &Path) -> anyhow::Result<()> {
    let results = report(out)?;
    if results.seeds.is_empty() {
        bail!("{}: no block has been trained there yet", out.display());
    }
    tell(out, &results);
    write_json_option(&arguments.json, &results.summary())
}

/// Prints the results of a folder.
fn tell(out: &Path, results: &Results) {
    say(table::blocks(results));
    for finals in FinalSeeds::ALL.map(|seeds| table::finals(results, seeds)) {
        finals.into_iter().for_each(say);
    }
    for note in table::notes(results) {
        say(note);
    }
    say(format_args!(
        "{}: curves.svg, curves.png, table.md, policy.onnx (the best), seed-*/",
        out.display()
    ));
}

/// Makes plots, tables and the best policy from the results in the folders.
fn report(out: &Path) -> anyhow::Result<Results> {
    let results = Results::read(out)?;
    if !results.seeds.is_empty() {
        write(out, &results)?;
    }
    Ok(results)
}

/// Writes plots, tables and the best policy.
fn write(out: &Path, results: &Results) -> anyhow::Result<()> {
    curves::draw(results, out)?;
    tensorboard::write(results, out)?;
    fs::write(out.join("table.md"), table::markdown(results)).context("table.md")?;
    if let Some(best) = results.best() {
        let file = best.policy();
        fs::copy(&file, out.join("policy.onnx")).with_context(|| file.display().to_string())?;
    }
    Ok(())
}
