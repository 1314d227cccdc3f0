//! The learner process.

use std::process::ExitCode;

use clap::Parser;
use learner::ports::{OfferPorts, Ports};
use runtime::{Arguments, Member, SetUpError, exit_code};
use shm_config::services::Process;
use shm_config::time::monotonic;

/// Learns from every step of a run, and offers the controller better weights
#[derive(Parser)]
#[command(name = "vlaps-learner", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
}

fn main() -> ExitCode {
    exit_code(Process::Learner, run(&Cli::parse().arguments))
}

#[allow(clippy::disallowed_methods)] // a process entry point chooses the clock
fn run(arguments: &Arguments) -> Result<(), SetUpError> {
    let member = Member::join(Process::Learner, arguments, monotonic)?;
    let ports = Ports::open(&member.wire)?;
    let offers = OfferPorts::open(&member.wire)?;
    learner::run(member, ports, offers)
}
