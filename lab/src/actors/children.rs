//! The actors on this machine: child processes, each connected by a pair of sockets.
//!
//! The pair has no path in the file system: a run's folder may have a path that is longer than
//! that of a socket may be, and no other user can connect. A child ends with this process.

use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus};

use anyhow::{Context, bail};

use super::order::SeatNumber;
use super::pool::Pool;

/// Ends of an actor without an episode between them, after which the training gives up.
const DEATHS_MAX: u32 = 8;

/// An actor's process.
struct Process {
    name: String,
    child: Child,
    seat: SeatNumber,
    deaths: u32,
}

/// The processes of this machine's actors.
pub struct Children {
    program: PathBuf,
    processes: Vec<Process>,
}

impl Children {
    /// Starts so many.
    ///
    /// # Errors
    /// When a process cannot be started.
    pub fn start(count: u32, pool: &mut Pool) -> anyhow::Result<Children> {
        let mut children = Children {
            program: match count {
                0 => PathBuf::new(),
                _ => program()?,
            },
            processes: Vec::new(),
        };
        for index in 0..count {
            let name = format!("actor {index}");
            let (child, seat) = children.spawn(&name, pool)?;
            children.processes.push(Process {
                name,
                child,
                seat,
                deaths: 0,
            });
        }
        Ok(children)
    }

    fn spawn(&self, name: &str, pool: &mut Pool) -> anyhow::Result<(Child, SeatNumber)> {
        let (own, theirs) = UnixStream::pair().context("a pair of sockets")?;
        let child = Command::new(&self.program)
            .args(["actor", "--parent", &std::process::id().to_string()])
            .stdin(OwnedFd::from(theirs))
            // Ctrl-C is for this process, which ends its actors.
            .process_group(0)
            .spawn()
            .with_context(|| self.program.display().to_string())?;
        let seat = pool.add_local(name.to_string(), own)?;
        Ok((child, seat))
    }

    /// Starts the actor of a connection that has ended again; returns how it has ended, and
    /// `None` for an actor of another machine.
    ///
    /// # Errors
    /// When it ends again and again, or cannot be started.
    pub fn restart(
        &mut self,
        seat: SeatNumber,
        pool: &mut Pool,
        why: &str,
    ) -> anyhow::Result<Option<ExitStatus>> {
        let found = self.processes.iter().position(|own| own.seat == seat);
        let Some(index) = found else {
            return Ok(None);
        };
        let own = &mut self.processes[index];
        own.deaths += 1;
        // A process that broke the protocol may still live.
        let _ = own.child.kill();
        let ended = own.child.wait().context("an actor")?;
        if own.deaths > DEATHS_MAX {
            bail!(
                "{} ended {} times without driving an episode, the last time: {why} ({ended})",
                own.name,
                own.deaths
            );
        }
        let (child, seat) = self.spawn(&self.processes[index].name, pool)?;
        let own = &mut self.processes[index];
        (own.child, own.seat) = (child, seat);
        Ok(Some(ended))
    }

    /// The actor of a connection has driven an episode.
    pub fn thrives(&mut self, seat: SeatNumber) {
        let own = self.processes.iter_mut().find(|own| own.seat == seat);
        if let Some(own) = own {
            own.deaths = 0;
        }
    }
}

impl Drop for Children {
    fn drop(&mut self) {
        for own in &mut self.processes {
            // They hold nothing that is worth waiting for, and may have ended.
            let _ = own.child.kill();
            let _ = own.child.wait();
        }
    }
}

/// The program that drives: this one, or the one beside a benchmark.
fn program() -> anyhow::Result<PathBuf> {
    let own = std::env::current_exe().context("the path of this program")?;
    let path = own.parent().unwrap_or(Path::new(".")).join("vlaps-lab");
    match path.exists() {
        true => Ok(path),
        false => bail!("{}: missing; `./vlaps train` builds it", path.display()),
    }
}
