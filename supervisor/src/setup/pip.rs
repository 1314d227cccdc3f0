//! Programs that a set-up runs.

use std::path::PathBuf;
use std::process::{Command, Output};

use crate::cli::failure::Failure;

pub(crate) fn output_of(command: &mut Command) -> Result<Output, Failure> {
    let program = PathBuf::from(command.get_program());
    command
        .output()
        .map_err(|error| Failure::GivenUp(format!("cannot start {}: {error}", program.display())))
}

/// The last line of the error output, in which Python and pip give the reason.
pub(crate) fn last_line(output: &Output) -> String {
    let errors = String::from_utf8_lossy(&output.stderr);
    let lines = || {
        errors
            .lines()
            .map(str::trim)
            .filter(|line| !line.is_empty())
    };
    let reason = lines()
        .rev()
        .find(|line| line.starts_with("ERROR"))
        .or(lines().next_back());
    reason.unwrap_or("no reason given").to_string()
}
