//! `vlaps-link-judge`: stands in a set for the judge of another machine.

use std::process::ExitCode;

use clap::Parser;
use runtime::{Arguments, exit_code};
use shm_config::services::Process;

/// Stands in a set for the judge of another machine
#[derive(Parser)]
#[command(name = "vlaps-link-judge", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
}

fn main() -> ExitCode {
    let arguments = Cli::parse().arguments;
    exit_code(Process::Gate, vlaps_link::stand_in::judge(&arguments))
}
