//! `vlaps-link-learner`: stands in a set for the learner of another machine.

use std::process::ExitCode;

use clap::Parser;
use runtime::{Arguments, exit_code};
use shm_config::services::Process;

/// Stands in a set for the learner of another machine
#[derive(Parser)]
#[command(name = "vlaps-link-learner", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
}

fn main() -> ExitCode {
    let arguments = Cli::parse().arguments;
    exit_code(Process::Learner, vlaps_link::stand_in::learner(&arguments))
}
