//! `vlaps-judge`: the offline tools for judges.

mod arguments;
mod auditing;
mod configuration;
mod distilling;
mod print;
mod serving;

use std::io::Write as _;
use std::process::ExitCode;

use anyhow::Context as _;
use clap::Parser as _;
use shm_config::secret;
use shm_config::text::{causes, printable_arguments, printable_lines};

use crate::arguments::{Arguments, Command};

fn main() -> ExitCode {
    // Take the keys first, so that nothing else can copy them from the environment.
    let taken = secret::take().context("cannot take the keys out of the environment");
    let arguments = Arguments::try_parse().unwrap_or_else(|error| {
        let shown = Arguments::try_parse_from(printable_arguments()).err();
        shown.unwrap_or(error).exit()
    });
    let done = taken.and_then(|()| match arguments.command {
        Command::Serve(arguments) => serving::serve(&arguments),
        Command::Audit(arguments) => auditing::audit(&arguments),
        Command::Replay(arguments) => auditing::replay(&arguments),
        Command::Distil(arguments) => distilling::distil(&arguments),
    });
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let shown = format!("vlaps-judge: {}", causes(&*error));
            // Standard error may be closed.
            let _ = writeln!(std::io::stderr(), "{}", printable_lines(&shown));
            ExitCode::FAILURE
        }
    }
}
