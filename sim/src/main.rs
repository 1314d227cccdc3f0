//! The world process.

use std::process::ExitCode;

use clap::Parser;
use robot::clock::Begin;
use runtime::{Arguments, Member, SetUpError, exit_code};
use shm_config::services::Process;
use shm_config::time::monotonic;

/// Drives the built-in world: maps, traffic and rules of MetaDrive
#[derive(Parser)]
#[command(name = "vlaps-world", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
    #[command(flatten)]
    begin: Begin,
}

fn main() -> ExitCode {
    exit_code(Process::World, run(&Cli::parse()))
}

#[allow(clippy::disallowed_methods)] // a process entry point chooses the clock
fn run(cli: &Cli) -> Result<(), SetUpError> {
    let member = Member::join(Process::World, &cli.arguments, monotonic)?;
    sim::run(member, cli.begin)
}
