//! `vlaps-lab`: `./vlaps eval`, `train`, `sweep` and `draw`.

use std::process::ExitCode;

use lab::Command;
use shm_config::time::monotonic;
use supervisor::subcommand;

fn main() -> ExitCode {
    // A process entry point: only entry points read the clock.
    #[allow(clippy::disallowed_methods)]
    subcommand::main::<Command>(monotonic)
}
