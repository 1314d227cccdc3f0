//! `vlaps-view`: `./vlaps view`.

use std::process::ExitCode;

use shm_config::time::monotonic;
use supervisor::subcommand;
use view::live::command::View;

supervisor::subcommands! {
    /// The commands of this program.
    Command {
        View(View),
    }
}

fn main() -> ExitCode {
    // A process entry point: the clock is read nowhere else.
    #[allow(clippy::disallowed_methods)]
    subcommand::main::<Command>(monotonic)
}
