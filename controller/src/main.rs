//! The controller process.

use std::process::ExitCode;

use clap::Parser;
use controller::ports::Ports;
use runtime::{Arguments, Member, SetUpError, exit_code};
use shm_config::services::Process;
use shm_config::time::monotonic;

/// Answers every observation with a command, and records which driver drove and why
#[derive(Parser)]
#[command(name = "vlaps-controller", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
}

fn main() -> ExitCode {
    exit_code(Process::Controller, run(&Cli::parse().arguments))
}

#[allow(clippy::disallowed_methods)] // a process entry point chooses the clock
fn run(arguments: &Arguments) -> Result<(), SetUpError> {
    let member = Member::join(Process::Controller, arguments, monotonic)?;
    let ports = Ports::open(&member.wire)?;
    controller::run(member, ports)
}
