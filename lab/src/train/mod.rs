//! `./vlaps train`: the paper's experiment (Sec. 5), on the real process set.
//!
//! | module | holds |
//! |---|---|
//! | [`arguments`] | the command line |
//! | [`experiment`] | with which options a folder was begun, and which process trains in it |
//! | [`protocol`] | the experiment's numbers, as configuration |
//! | [`student`] | one training: the process set in lockstep, watched |
//! | [`examiner`] | 50 episodes without intervention after every block |
//! | [`results`] | what the folders hold, read back |
//! | [`doubts`] | blocks that taught nothing, or whose policy did not drive |
//! | [`curves`] | Figure 4, as SVG and PNG |
//! | [`table`] | Table 1, and the mean over seeds |
//! | [`tensorboard`] | the same numbers as an event file |
//!
//! Everything is in the folder, and everything printed is computed from it: an
//! interrupted experiment continues with `--resume`, a finished one is only
//! reported again.

pub mod arguments;
pub mod curves;
pub mod doubts;
pub mod examiner;
pub mod experiment;
pub mod protocol;
pub mod results;
pub mod student;
pub mod table;
pub mod tensorboard;

use std::fs;
use std::path::Path;

use anyhow::{Context, bail};

use crate::stop::Stop;
use arguments::Train;
use experiment::Experiment;
use protocol::Protocol;
use results::Results;
use stack::Clock;
use student::End;
use supervisor::subcommand::{say, write_json_option};

/// Trains with every seed asked for, and reports.
///
/// # Errors
/// When the configuration is wrong, a folder holds another experiment, the
/// process set gives up, or a stop is requested.
pub fn train(arguments: &Train, clock: Clock) -> anyhow::Result<()> {
    if arguments.report {
        return tell(arguments, &experiment::folder(arguments));
    }
    let stop = Stop::listen()?;
    let (experiment, out) = Experiment::open(arguments)?;
    let protocols: Vec<Protocol> = experiment
        .all_seeds()
        .map(|seed| Protocol::new(&experiment, (seed, &out)))
        .collect::<anyhow::Result<_>>()?;
    let _held = experiment::hold(&out)?;
    // Not before all options are known to be right: --resume would go on with them.
    experiment.write(&out)?;
    for protocol in &protocols {
        let end = student::train(protocol, &stop, clock)?;
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
    let end = examiner::examine_finals(&experiment, &results, &out, watch)?;
    tell(arguments, &out)?;
    match end {
        End::Complete => Ok(()),
        End::Stopped { .. } => bail!(
            "stopped in the evaluation of a last policy; all is trained, the same command with \
             --resume continues"
        ),
    }
}

/// Draws, prints and writes what a folder holds.
fn tell(arguments: &Train, out: &Path) -> anyhow::Result<()> {
    let results = report(out)?;
    if results.seeds.is_empty() {
        bail!("{}: no block is trained there yet", out.display());
    }
    say(table::blocks(&results));
    if let Some(finals) = table::finals(&results) {
        say(finals);
    }
    for note in table::notes(&results) {
        say(note);
    }
    write_json_option(&arguments.json, &results.summary())?;
    say(format_args!(
        "{}: curves.svg, curves.png, table.md, policy.onnx (the best), seed-*/",
        out.display()
    ));
    Ok(())
}

/// Pictures, tables and the best policy, from what the folders hold.
fn report(out: &Path) -> anyhow::Result<Results> {
    let results = Results::read(out)?;
    if results.seeds.is_empty() {
        return Ok(results);
    }
    curves::draw(&results, out)?;
    tensorboard::write(&results, out)?;
    fs::write(out.join("table.md"), table::markdown(&results)).context("table.md")?;
    if let Some(best) = results.best() {
        let file = best.policy();
        fs::copy(&file, out.join("policy.onnx")).with_context(|| file.display().to_string())?;
    }
    Ok(results)
}
