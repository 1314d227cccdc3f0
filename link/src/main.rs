//! `vlaps-link`: `./vlaps link` and `./vlaps join`.

use std::io;
use std::process::ExitCode;

use clap::Parser;
use shm_config::secret;
use shm_config::text::{Printable, printable_lines};
use vlaps_link::carrier::use_one_thread;
use vlaps_link::commands::Command;

/// Judge, learner, view and recorder of a set on other machines.
#[derive(Parser)]
#[command(name = "vlaps", bin_name = "./vlaps", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

fn main() -> ExitCode {
    // Done before the first thread starts; a judge's key goes to the gate alone.
    let taken = use_one_thread()
        .and_then(|()| secret::take().map_err(|error| format!("the environment: {error}")));
    let command = Cli::parse().command;
    tracing_subscriber::fmt()
        .with_writer(|| Printable(io::stderr()))
        .with_ansi(false)
        .with_target(false)
        // Zenoh's own lines repeat with each attempt to connect.
        .with_env_filter("info,zenoh=off")
        .init();
    let done = taken.and_then(|()| command.carry_out());
    match done {
        Ok(code) => ExitCode::from(code),
        Err(line) => {
            eprintln!("vlaps-link: {}", printable_lines(&line));
            ExitCode::from(2)
        }
    }
}
