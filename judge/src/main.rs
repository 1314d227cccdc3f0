//! `vlaps-judge`: the offline tools for judges.

mod arguments;
mod auditing;

use std::fmt;
use std::io::Write as _;
use std::process::ExitCode;

use anyhow::Context as _;
use clap::Parser as _;
use judge::standin::{NAME, Server};
use shm_config::text::{causes, printable_arguments, printable_lines};
use shm_config::{counted, secret};

use crate::arguments::{Arguments, Command, ServeArguments};

/// As the supervisor's programs exit when they failed.
const EXIT_FAILED: u8 = 1;

fn main() -> ExitCode {
    // Before anything else: nothing may copy the environment.
    let taken = secret::take().context("cannot take the keys out of the environment");
    let arguments = Arguments::try_parse().unwrap_or_else(|error| {
        let shown = Arguments::try_parse_from(printable_arguments()).err();
        shown.unwrap_or(error).exit()
    });
    let done = taken.and_then(|()| match arguments.command {
        Command::Serve(arguments) => serve(&arguments),
        Command::Audit(arguments) => auditing::audit(&arguments),
        Command::Replay(arguments) => auditing::replay(&arguments),
    });
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let shown = format!("vlaps-judge: {}", causes(&*error));
            // The reader may have gone.
            let _ = writeln!(std::io::stderr(), "{}", printable_lines(&shown));
            ExitCode::from(EXIT_FAILED)
        }
    }
}

/// Runs a stand-in until a signal comes.
fn serve(arguments: &ServeArguments) -> anyhow::Result<()> {
    let stop = [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM];
    let mut stop = signal_hook::iterator::Signals::new(stop).context("cannot handle signals")?;
    let server = Server::start(arguments.options()).with_context(|| {
        let port = arguments.port;
        format!("cannot listen on 127.0.0.1:{port}; --port 0 takes any free one")
    })?;
    let url = server.url();
    say(format_args!(
        "{NAME} listens on {url}: a stand-in that judges coloured pixels, no model; asked as \
         vlm.model={NAME}, it costs nothing. Ctrl-C stops it"
    ));
    if let Some(mishap) = arguments.fault {
        let share = arguments.fault_share;
        let mishap = mishap.word();
        say(format_args!(
            "it breaks at a share of {share} of its questions: {mishap}"
        ));
    }
    stop.forever().next();
    let answered = counted(server.requests(), "question");
    say(format_args!("answered {answered}"));
    Ok(())
}

/// A line for people and scripts; a reader that has gone is no reason to stop.
fn say(line: impl fmt::Display) {
    let line = line.to_string();
    let _ = writeln!(std::io::stdout(), "{}", printable_lines(&line));
}
