//! The entry point of a robot's program.

use std::process::ExitCode;

use clap::Parser;
use runtime::{Arguments, Member, SetUpError, exit_code};
use shm_config::config::Config;
use shm_config::services::Process;
use shm_config::time::monotonic;

use crate::clock::Begin;
use crate::driven::Driven;
use crate::process::run;
use crate::robot::Robot;

/// A world process that `./vlaps up --world PROGRAM` starts
#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
    #[command(flatten)]
    begin: Begin,
}

/// Runs a robot as the world of the run that started this program: the whole `main`.
/// `make` connects to the robot, given the run's configuration; its error becomes the
/// program's one line and exit code 2.
///
/// What only the robot needs, such as a device or an address, comes by an environment
/// variable or a file of its own: the arguments are those of every world.
pub fn drive<R: Robot>(make: impl FnOnce(&Config) -> Result<R, String>) -> ExitCode {
    let cli = Cli::parse();
    exit_code(Process::World, join(&cli, make))
}

#[allow(clippy::disallowed_methods)] // a process entry point chooses the clock
fn join<R: Robot>(
    cli: &Cli,
    make: impl FnOnce(&Config) -> Result<R, String>,
) -> Result<(), SetUpError> {
    let member = Member::join(Process::World, &cli.arguments, monotonic)?;
    let robot = make(&member.config).map_err(SetUpError::Own)?;
    let driven = Driven::new(robot, &member.config);
    run(member, driven, cli.begin)
}
