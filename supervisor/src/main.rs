//! `vlaps-supervisor`: the process behind `./vlaps`.

use std::process::ExitCode;

use clap::Parser;
use shm_config::secret;
use shm_config::text::{printable_arguments, printable_lines};
use shm_config::time::monotonic;
use supervisor::Clock;
use supervisor::arguments::Arguments;
use supervisor::cli::failure::Failure;
use supervisor::dispatch::carry_out;

fn main() -> ExitCode {
    // First, so that nothing copies the environment with the keys in it.
    let taken = secret::take().map_err(Failure::secrets);
    let arguments = Arguments::try_parse().unwrap_or_else(|error| {
        let shown = Arguments::try_parse_from(printable_arguments()).err();
        shown.unwrap_or(error).exit()
    });
    // A process entry point: no other code reads the clock.
    #[allow(clippy::disallowed_methods)]
    let clock: Clock = monotonic;
    let done = taken.and_then(|()| carry_out(&arguments.command, clock));
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            use std::io::Write;
            let failure_shown = failure.to_string();
            let failure_shown = printable_lines(&failure_shown);
            // The reader of stderr may be gone.
            let _ = writeln!(std::io::stderr(), "error: {failure_shown}");
            ExitCode::from(failure.exit_code())
        }
    }
}
