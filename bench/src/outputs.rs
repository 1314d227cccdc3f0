//! What a command writes at its end, checked before its begin: nobody waits an
//! hour for a file that cannot be written.

use std::path::{Path, PathBuf};

use supervisor::cli::failure::Failure;
use supervisor::cli::output::{check_file, check_folder};

use crate::arguments::{Bench, Command, Draw};

/// Everything that the command's options ask to be written can be.
///
/// # Errors
/// The first that cannot, and what to do.
pub fn check(command: &Command) -> Result<(), Failure> {
    let (option, file): (_, &Option<PathBuf>) = match command {
        Command::Eval(arguments) => {
            if let Some(folder) = &arguments.draw {
                check_folder("--draw", folder)?;
            }
            ("--json", &arguments.json)
        }
        Command::Train(arguments) => {
            if let Some(folder) = &arguments.out {
                check_parent("--out", folder)?;
            }
            check_folder("--out", &crate::train::experiment::folder(arguments))?;
            ("--json", &arguments.json)
        }
        Command::Bench(bench) => {
            if let Bench::Planner(arguments) = bench
                && let Some(file) = &arguments.record
            {
                check_file("--record", file)?;
            }
            if let Bench::Judge(arguments) = bench
                && let Some(folder) = &arguments.record
            {
                check_folder("--record", folder)?;
            }
            if let Bench::Latency(arguments) = bench
                && let Some(folder) = &arguments.out
            {
                check_folder("--out", folder)?;
            }
            if let Bench::Faults(arguments) = bench
                && let Some(folder) = &arguments.out
            {
                check_folder("--out", folder)?;
            }
            if let Bench::Soak(arguments) = bench {
                check_folder("--out", &arguments.out)?;
            }
            ("--json", json(bench))
        }
        Command::Draw(Draw::Map(arguments)) => ("--out", &arguments.out),
        Command::Draw(Draw::Episode(arguments)) => ("--out", &arguments.out),
        Command::Draw(Draw::Frame(arguments)) => ("--out", &arguments.out),
        Command::Draw(Draw::Plan(arguments)) => ("--out", &arguments.out),
    };
    match file {
        Some(file) => check_file(option, file),
        None => Ok(()),
    }
}

/// A folder that is worked in for hours is made in one that exists: a path with a slip
/// in it would be found when the work is done.
fn check_parent(option: &str, path: &Path) -> Result<(), Failure> {
    let parent = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => return Ok(()),
    };
    match parent.is_dir() {
        true => Ok(()),
        false => Err(Failure::Usage(format!(
            "{option} {}: cannot write there: {} is no folder; name a place in an existing folder",
            path.display(),
            parent.display()
        ))),
    }
}

fn json(bench: &Bench) -> &Option<PathBuf> {
    match bench {
        Bench::Parity(arguments) => &arguments.json,
        Bench::Sim(arguments) => &arguments.json,
        Bench::Planner(arguments) => &arguments.json,
        Bench::Mpc(arguments) => &arguments.json,
        Bench::Policy(arguments) => &arguments.json,
        Bench::Learner(arguments) => &arguments.json,
        Bench::Swap(arguments) => &arguments.json,
        Bench::Judge(arguments) => &arguments.json,
        Bench::Latency(arguments) => &arguments.json,
        Bench::Ipc(arguments) => &arguments.json,
        Bench::IpcEcho(_) => &None,
        Bench::Faults(arguments) => &arguments.json,
        Bench::Soak(arguments) => &arguments.json,
        Bench::Sweep(arguments) => &arguments.json,
    }
}
