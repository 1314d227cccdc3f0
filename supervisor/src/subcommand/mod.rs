//! A command of `./vlaps` with a program of its own, such as `eval` or `bench latency`:
//! it has options, declares its outputs, and runs.
//!
//! [`crate::subcommands!`] makes the table of a program's commands: one line each.

pub mod settings;

use std::fmt;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::{Args, Parser};
use serde::Serialize;
use shm_config::config::Config;
use shm_config::secret;
use shm_config::text::{printable_arguments, printable_json, printable_lines};

use crate::Clock;
use crate::cli::failure::{EXIT_FAILED, Failure};
use crate::cli::output::{check_file, check_folder};

/// A command with its parsed options.
pub trait Subcommand: fmt::Debug {
    /// Its outputs. They are checked before it runs, so that a command that takes an
    /// hour does not end with a file that cannot be written.
    fn outputs(&self) -> Vec<Output>;

    /// Runs the command. Exit code 1: it ran, and the answer is no.
    ///
    /// # Errors
    /// When it cannot run to its end.
    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode>;
}

/// The output of an option; none when the option is not given.
#[derive(Clone, Debug)]
pub enum Output {
    /// A file.
    File(&'static str, Option<PathBuf>),
    /// A folder, which is created with its parents.
    Folder(&'static str, Option<PathBuf>),
    /// A folder whose parent exists: long work fills it, so a typing error in its path
    /// is reported at once.
    FolderOfParent(&'static str, Option<PathBuf>),
}

impl Output {
    /// The file of `--json`.
    pub fn json(file: &Option<PathBuf>) -> Self {
        Self::File("--json", file.clone())
    }

    fn check(self) -> Result<(), Failure> {
        match self {
            Self::File(option, Some(path)) => check_file(option, &path),
            Self::Folder(option, Some(path)) => check_folder(option, &path),
            Self::FolderOfParent(option, Some(path)) => {
                check_parent(option, &path)?;
                check_folder(option, &path)
            }
            Self::File(_, None) | Self::Folder(_, None) | Self::FolderOfParent(_, None) => Ok(()),
        }
    }
}

fn check_parent(option: &str, path: &Path) -> Result<(), Failure> {
    let parent = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => return Ok(()),
    };
    match parent.is_dir() {
        true => Ok(()),
        false => Err(Failure::Usage(format!(
            "{option} {}: cannot write there: {} is not a folder; name a place in an existing folder",
            path.display(),
            parent.display()
        ))),
    }
}

/// Defines an enum of commands, each with the type of its options, which implements
/// [`Subcommand`].
#[macro_export]
macro_rules! subcommands {
    (
        $(#[$of_enum:meta])*
        $name:ident { $($(#[$of_row:meta])* $command:ident($arguments:ty),)* }
    ) => {
        $(#[$of_enum])*
        #[derive(Debug, clap::Subcommand)]
        #[allow(missing_docs)] // the text of --help stands at the options
        pub enum $name {
            $($(#[$of_row])* $command($arguments),)*
        }

        impl $crate::subcommand::Subcommand for $name {
            fn outputs(&self) -> Vec<$crate::subcommand::Output> {
                match self {
                    $(Self::$command(command) => command.outputs(),)*
                }
            }

            fn run(&self, clock: $crate::Clock) -> anyhow::Result<std::process::ExitCode> {
                match self {
                    $(Self::$command(command) => command.run(clock),)*
                }
            }
        }
    };
}

/// The command line of a program that `./vlaps` hands over to.
#[derive(Debug, Parser)]
#[command(
    name = "vlaps",
    bin_name = "./vlaps",
    version,
    arg_required_else_help = true
)]
pub struct Program<Command: clap::Subcommand> {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The `main` of such a program.
pub fn main<Command: clap::Subcommand + Subcommand>(clock: Clock) -> ExitCode {
    // Before anything else: nothing may copy the environment.
    let taken = secret::take().map_err(Failure::secrets);
    let program = Program::<Command>::try_parse().unwrap_or_else(|error| {
        let shown = Program::<Command>::try_parse_from(printable_arguments()).err();
        shown.unwrap_or(error).exit()
    });
    let command = program.command;
    let checked = taken.and_then(|()| command.outputs().into_iter().try_for_each(Output::check));
    let done = checked
        .map_err(anyhow::Error::from)
        .and_then(|()| command.run(clock));
    done.unwrap_or_else(|error| {
        let shown = format!("error: {error:#}");
        // The terminal may be closed.
        let _ = writeln!(std::io::stderr(), "{}", printable_lines(&shown));
        let failure = error.downcast_ref::<Failure>();
        ExitCode::from(failure.map_or(EXIT_FAILED, Failure::exit_code))
    })
}

/// The configuration of a run.
#[derive(Debug, Args)]
pub struct Configuration {
    /// Configuration file; vlaps.toml of the current folder is read when present.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Vehicle file: the sections `vehicle` and `scanner` of the car, such as
    /// vehicles/truck.toml; its keys replace those of the configuration file.
    #[arg(long, value_name = "FILE")]
    pub vehicle: Option<PathBuf>,
    /// Override any key of the configuration, such as world.blocks=5; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
}

impl Configuration {
    /// As [`settings::config`] has it.
    ///
    /// # Errors
    /// When the file or an override is wrong; the error names the one that is.
    pub fn resolve(&self) -> Result<Config, Failure> {
        let files = [self.config.as_deref(), self.vehicle.as_deref()];
        settings::config(files, &self.overrides)
    }
}

/// A span of measuring, s.
///
/// # Errors
/// When it is no number from 0.1 to 3600.
pub fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| "not a number".to_string())?;
    match (0.1..=3600.0).contains(&seconds) {
        true => Ok(seconds),
        false => Err("must be within 0.1 and 3600".into()),
    }
}

/// Prints to standard output; a closed reader is no error.
pub fn say(text: impl fmt::Display) {
    let text = text.to_string();
    let _ = writeln!(std::io::stdout(), "{}", printable_lines(&text));
}

/// Writes one JSON object to a file.
///
/// # Errors
/// When the file cannot be written.
pub fn write_json(path: &Path, value: &impl Serialize) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(value).context("the JSON")?;
    let text = format!("{}\n", printable_json(&text));
    std::fs::write(path, text).with_context(|| path.display().to_string())
}

/// Writes the figures to the file of `--json`, when it is given.
///
/// # Errors
/// When the file cannot be written.
pub fn write_json_option(path: &Option<PathBuf>, value: &impl Serialize) -> anyhow::Result<()> {
    path.as_deref()
        .map_or(Ok(()), |path| write_json(path, value))
}
