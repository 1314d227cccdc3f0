//! `vlaps-recorder`: records every message of a run.

mod command;

use std::process::ExitCode;

use clap::Parser;
use recorder::process;
use runtime::{Arguments, exit_code};
use shm_config::services::Process;

use command::{Record, record};

/// Records every message of a run
#[derive(Parser)]
#[command(name = "vlaps-recorder", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
}

fn main() -> ExitCode {
    let mut words = std::env::args_os();
    if words.nth(1).is_some_and(|word| word == "record") {
        let words = std::iter::once("record".into()).chain(words);
        return record(&Record::parse_from(words));
    }
    exit_code(Process::Recorder, process::run(&Cli::parse().arguments))
}
