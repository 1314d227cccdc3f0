//! Command line of `./vlaps actor`.

use std::io;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::process::ExitCode;

use anyhow::{Context, bail};
use clap::Args;
use stack::Clock;
use supervisor::machine::parent::end_with;
use supervisor::subcommand::{Output, Subcommand};

use super::actor::serve;

/// Drive episodes for a training, which `./vlaps train --actors` starts.
#[derive(Debug, Args)]
#[command(
    after_help = "An actor has worlds, experts, the policy and the safety check in one process. It \
        drives the episodes that the training asks for, sends their steps, and keeps nothing: it \
        may be stopped and killed at any time.\n\n\
        Examples:\n  \
        ./vlaps train --algorithm ppl --actors 4 --out runs/ppl"
)]
pub struct Actor {
    /// Process id of the training that started this actor, with which it ends.
    #[arg(long, value_name = "PID", hide = true)]
    pub parent: Option<u32>,
}

impl Subcommand for Actor {
    fn outputs(&self) -> Vec<Output> {
        Vec::new()
    }

    fn run(&self, _: Clock) -> anyhow::Result<ExitCode> {
        let Some(parent) = self.parent else {
            bail!("./vlaps train --actors starts the actors of this machine");
        };
        end_with(parent)?;
        let socket = io::stdin().as_fd().try_clone_to_owned();
        let mut line = UnixStream::from(socket.context("standard input")?);
        match serve(&mut line) {
            Ok(()) => Ok(ExitCode::SUCCESS),
            Err(broken) => bail!("the training: {broken}"),
        }
    }
}
