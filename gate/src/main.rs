//! `vlaps-gate`: asks a judge at its own pace and publishes advice.

use std::process::ExitCode;

use clap::Parser;
use runtime::{Arguments, SetUpError, exit_code};
use shm_config::secret;
use shm_config::services::Process;

/// Asks a judge which of two proposals is safer, and publishes its advice
#[derive(Parser)]
#[command(name = "vlaps-gate", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
}

fn main() -> ExitCode {
    // Done before the process holds a key.
    let guarded = secret::forbid_dumps().map_err(|error| {
        SetUpError::Own(format!("cannot keep the key out of core files: {error}"))
    });
    let arguments = Cli::parse().arguments;
    exit_code(Process::Gate, guarded.and_then(|()| gate::run(&arguments)))
}
