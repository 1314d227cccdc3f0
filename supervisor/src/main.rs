//! `vlaps-supervisor`: the process behind `./vlaps`.

use std::process::ExitCode;

use clap::Parser;
use shm_config::secret;
use shm_config::text::{printable_arguments, printable_lines};
use shm_config::time::monotonic;
use supervisor::Clock;
use supervisor::arguments::{Arguments, Command};
use supervisor::cli::failure::Failure;
use supervisor::commands::delegate::{BENCH, JUDGE, LAB, delegate};
use supervisor::commands::{clean, config, doctor, down, setup, status, swap, up};

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

fn carry_out(command: &Command, clock: Clock) -> Result<(), Failure> {
    match command {
        Command::Up(arguments) => up::up(arguments, clock),
        Command::Down(arguments) => down::down(arguments),
        Command::Status(arguments) => status::status(arguments, clock),
        Command::Swap(arguments) => swap::swap(arguments, clock),
        Command::Doctor => doctor::doctor(clock),
        Command::Clean(arguments) => clean::clean(arguments),
        Command::Setup(arguments) => setup::setup(arguments),
        Command::Config(arguments) => config::config(arguments),
        Command::Eval(words) => delegate(LAB, &["eval"], words),
        Command::Bench(words) => delegate(BENCH, &["bench"], words),
        Command::Draw(words) => delegate(LAB, &["draw"], words),
        Command::Judge(words) => delegate(JUDGE, &[], words),
        Command::Train(words) => delegate(LAB, &["train"], words),
        Command::Sweep(words) => delegate(LAB, &["sweep"], words),
    }
}
