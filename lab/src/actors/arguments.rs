//! Command line of `./vlaps actor`.

use std::io;
use std::num::NonZeroUsize;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, bail};
use clap::Args;
use stack::Clock;
use supervisor::cli::parsers::whole;
use supervisor::machine::parent::end_with;
use supervisor::subcommand::{Output, Subcommand};

use super::actor::serve;
use super::remote::drive;
use super::tls::Invitation;
use crate::stop::Stop;

/// Drive episodes for a training on another machine.
#[derive(Debug, Args)]
#[command(
    after_help = "An actor has worlds, expert, policy and safety check in one process. It drives the \
        episodes that the training asks for, sends their steps over mutual TLS, and keeps nothing: \
        it may be stopped and killed at any time. It connects again for a minute, and after a \
        training waits half a minute for the next one. The build has to be that of the training. Exit \
        code 1: no training was served, or it refuses this actor.\n\n\
        Examples:\n  \
        ./vlaps link invite --run fleet --as actor --address 192.168.7.2:7460 --out actor.bundle\n  \
        ./vlaps train --algorithm ppl --actors-at 192.168.7.2:7460 --actors-run fleet --out runs/ppl\n  \
        ./vlaps actor actor.bundle --worlds 8"
)]
pub struct Actor {
    /// The invitation that `./vlaps link invite --as actor` made.
    #[arg(value_name = "BUNDLE", required_unless_present = "parent")]
    pub invitation: Option<PathBuf>,
    /// Number of worlds that drive side by side; default: number of cores.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u32>(1..=64))]
    pub worlds: Option<u32>,
    /// Process id of the training that started this actor, with which it ends.
    #[arg(long, value_name = "PID", hide = true, conflicts_with_all = ["invitation", "worlds"])]
    pub parent: Option<u32>,
}

impl Subcommand for Actor {
    fn outputs(&self) -> Vec<Output> {
        Vec::new()
    }

    fn run(&self, _: Clock) -> anyhow::Result<ExitCode> {
        match (&self.invitation, self.parent) {
            (Some(invitation), _) => {
                let invitation = Invitation::read(invitation)?;
                let cores = || std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
                let worlds = self.worlds.map_or_else(cores, |worlds| worlds as usize);
                drive(&invitation, worlds, &Stop::listen()?)?;
            }
            (None, Some(parent)) => serve_parent(parent)?,
            (None, None) => bail!("an invitation is missing"),
        }
        Ok(ExitCode::SUCCESS)
    }
}

/// Serves the training that started this process, to which standard input is connected.
fn serve_parent(parent: u32) -> anyhow::Result<()> {
    end_with(parent)?;
    let socket = io::stdin().as_fd().try_clone_to_owned();
    let mut line = UnixStream::from(socket.context("standard input")?);
    match serve(&mut line, "") {
        Ok(()) => Ok(()),
        Err(broken) => bail!("the training: {broken}"),
    }
}
