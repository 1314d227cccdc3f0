//! The planner process.

use std::process::ExitCode;

use clap::Parser;
use planner::ports::Ports;
use runtime::{Arguments, Member, SetUpError, exit_code};
use shm_config::services::Process;
use shm_config::time::monotonic;

/// Answers observations with plans, at its own rate
#[derive(Parser)]
#[command(name = "vlaps-planner", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
}

fn main() -> ExitCode {
    exit_code(Process::Planner, run(&Cli::parse().arguments))
}

#[allow(clippy::disallowed_methods)] // a process entry point chooses the clock
fn run(arguments: &Arguments) -> Result<(), SetUpError> {
    let member = Member::join(Process::Planner, arguments, monotonic)?;
    let ports = Ports::open(&member.wire)?;
    planner::run(member, ports)
}
