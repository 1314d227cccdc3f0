//! The arguments of `link` and `join`. The program of `link/` carries them out and includes
//! this file: it is built on request, and `--help` has to work without it.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use shm_config::config::is_address;
use shm_config::run::RunName;

/// What a peer may be.
const ROLES: [&str; 5] = ["judge", "learner", "view", "recorder", "actor"];

/// Other machines: judge, learner, view and recorder of a set.
#[derive(Debug, Args)]
#[command(
    arg_required_else_help = true,
    after_help = "Examples:\n  \
        ./vlaps link invite --run drive --as judge --address 192.168.7.2:7450 --out judge.bundle\n  \
        ./vlaps up --run drive --judge 192.168.7.2:7450\n  \
        ./vlaps join judge.bundle\n  \
        ./vlaps link serve drive --listen 192.168.7.2:7452\n  \
        ./vlaps link status drive\n\n\
        `./vlaps setup link` builds it; the guide is docs/machines.md. Exit code 1: it ran and the \
        answer is no; 2: it could not run."
)]
pub struct Link {
    /// What to do.
    #[command(subcommand)]
    pub command: LinkCommand,
}

/// A command of `link`.
#[derive(Debug, Subcommand)]
pub enum LinkCommand {
    /// Make an invitation for one peer of one role: its key and certificate, in one file.
    Invite(Invite),
    /// End the effect of an invitation; a session that lives ends within two seconds.
    Revoke(Revoke),
    /// Let views and recorders of other machines read a running set.
    Serve(Serve),
    /// Show the peers of a run, and what was refused.
    Status(LinkStatus),
    /// Print what `./vlaps train --actors-at` listens with; it holds a key.
    #[command(hide = true)]
    Listener(Listener),
}

/// Make an invitation.
#[derive(Debug, Args)]
pub struct Invite {
    /// The run.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub run: RunName,
    /// What the peer may be.
    #[arg(long = "as", value_name = "ROLE", value_parser = ROLES)]
    pub role: String,
    /// Where the peer reaches the vehicle.
    #[arg(long, value_name = "HOST:PORT", value_parser = address)]
    pub address: String,
    /// How long the invitation holds, hours.
    #[arg(long, value_name = "H", default_value_t = 168,
          value_parser = clap::value_parser!(u64).range(1..=8760))]
    pub hours: u64,
    /// The file to write, for its user alone. It is a secret: carry it as one.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// End the effect of an invitation.
#[derive(Debug, Args)]
pub struct Revoke {
    /// The run.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub run: RunName,
    /// The peer's identity, which invite and status print.
    pub peer: String,
}

/// Print what a training listens with.
#[derive(Debug, Args)]
pub struct Listener {
    /// The run.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub run: RunName,
}

/// Serve a running set.
#[derive(Debug, Args)]
pub struct Serve {
    /// The run.
    pub run: RunName,
    /// An address of this machine.
    #[arg(long, value_name = "HOST:PORT", value_parser = address)]
    pub listen: String,
}

/// Show peers and refusals.
#[derive(Debug, Args)]
pub struct LinkStatus {
    /// The run.
    #[arg(default_value = "default")]
    pub run: RunName,
    /// Write all of it to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Be the judge, learner, view or recorder of a set that drives on another machine.
#[derive(Debug, Args)]
#[command(
    after_help = "It runs until Ctrl-C. `./vlaps setup link` builds it; the guide is \
        docs/machines.md.\n\n\
        Examples:\n  \
        ./vlaps join judge.bundle\n  \
        ./vlaps join drive@192.168.7.2:7450 --as judge --bundle judge.bundle\n  \
        ./vlaps join far.bundle --run far"
)]
pub struct Join {
    /// The invitation, or RUN@HOST:PORT with --bundle.
    #[arg(value_name = "BUNDLE|RUN@HOST:PORT")]
    pub target: String,
    /// What to be; it has to be the role of the invitation.
    #[arg(long = "as", value_name = "ROLE", value_parser = ROLES)]
    pub role: Option<String>,
    /// The invitation.
    #[arg(long, value_name = "FILE")]
    pub bundle: Option<PathBuf>,
    /// Name of the run on this machine; RUN-ROLE without it.
    #[arg(long, value_name = "NAME")]
    pub run: Option<RunName>,
    /// This machine's configuration: of it the address and the key of a judge's model count.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// An address, as a parser of arguments.
pub fn address(text: &str) -> Result<String, String> {
    match is_address(text) {
        true => Ok(text.into()),
        false => Err("write it as HOST:PORT, such as 192.168.7.2:7450".into()),
    }
}
