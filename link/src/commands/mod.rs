//! What each command of `vlaps-link` does.

mod invite;
mod join;
mod status;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::Subcommand;

use crate::arguments::{Join, Link, LinkCommand};
use crate::serve::serve;

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Other machines.
    Link(Link),
    /// Join a set that drives on another machine.
    Join(Join),
}

impl Command {
    /// Carries it out; the exit code.
    ///
    /// # Errors
    /// One line: what failed, where, and what to do.
    pub fn carry_out(&self) -> Result<u8, String> {
        match self {
            Command::Link(Link { command }) => match command {
                LinkCommand::Invite(arguments) => invite::invite(arguments),
                LinkCommand::Revoke(arguments) => invite::revoke(arguments),
                LinkCommand::Serve(arguments) => {
                    let stop = stop_flag()?;
                    serve(&arguments.run, &arguments.listen, &stop).map(|()| 0)
                }
                LinkCommand::Status(arguments) => status::status(arguments),
                LinkCommand::Listener(arguments) => invite::listener(arguments),
            },
            Command::Join(arguments) => {
                let stop = stop_flag()?;
                join::join_run(arguments, &stop)
            }
        }
    }
}

fn stop_flag() -> Result<Arc<AtomicBool>, String> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        let registered = signal_hook::flag::register(signal, stop.clone());
        registered.map_err(|error| format!("cannot handle signals: {error}"))?;
    }
    Ok(stop)
}
