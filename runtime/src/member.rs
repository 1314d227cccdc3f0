//! Membership of a process in a run: what a process does at its start and end.

use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;
use rustix::process::Signal;
use shm_config::config::{Config, ConfigError, load};
use shm_config::run::{InvalidRunName, RunName};
use shm_config::secret;
use shm_config::services::Process;
use shm_config::text::{Printable, printable_lines};
use shm_config::time::{Clock, Instant};
use shm_config::wire::{Wire, WireError};

use crate::Privileges;
use crate::kernel::set_ordinary;
use crate::privileges::{Ask, stay_among};

/// The exit code of a process that could not be set up. At the first
/// start the supervisor gives the run up, because it would fail again.
pub const SET_UP_FAILED: u8 = 2;

/// The arguments that every process takes.
#[derive(Debug, Clone, Args)]
pub struct Arguments {
    /// The run's resolved configuration
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// Real-time priority to ask for (SCHED_FIFO); 0 for none
    #[arg(long, default_value_t = 0)]
    pub priority: u32,
    /// Core to stay on
    #[arg(long)]
    pub core: Option<usize>,
    /// Core among which a process without priority stays, with all its threads; repeatable
    #[arg(long, value_name = "CORE")]
    pub among: Vec<usize>,
}

/// Why a process could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum SetUpError {
    /// The configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The run's name is invalid.
    #[error(transparent)]
    Name(#[from] InvalidRunName),
    /// Shared memory refuses.
    #[error(transparent)]
    Wire(#[from] WireError),
    /// Signals cannot be handled.
    #[error("cannot handle signals: {0}")]
    Signals(#[from] std::io::Error),
    /// An error of this process alone.
    #[error("{0}")]
    Own(String),
}

/// A process that has joined its run.
pub struct Member {
    /// Which process it is.
    pub process: Process,
    /// The run's configuration.
    pub config: Config,
    /// Its membership in the run.
    pub wire: Wire,
    /// The machine's clock.
    pub clock: Clock,
    /// The privileges that it asked the kernel for, and those it got.
    pub privileges: Privileges,
    stop: Arc<AtomicBool>,
    _logs: Option<Logs>,
}

/// The logging thread; dropping it writes out the queued lines when the process ends.
struct Logs {
    _guard: tracing_appender::non_blocking::WorkerGuard,
}

impl Drop for Logs {
    /// The guard waits for its thread in a loop, and that thread has no privileges. If
    /// this thread kept its real-time priority, it could keep the logging thread from
    /// the core; both would then wait for as long as the kernel lets a real-time thread
    /// run, as would every other thread on that core.
    fn drop(&mut self) {
        set_ordinary();
    }
}

impl Member {
    /// Joins the run of the configuration. [`Member::apply_privileges`] asks for
    /// real-time privileges later, when everything is allocated.
    ///
    /// # Errors
    /// One line that says what is wrong and what to do.
    pub fn join(process: Process, arguments: &Arguments, clock: Clock) -> Result<Self, SetUpError> {
        die_with_parent();
        // Done before the first thread starts: no other copy of the environment exists
        // yet.
        secret::take().map_err(|error| {
            SetUpError::Own(format!(
                "cannot take the keys out of the environment: {error}"
            ))
        })?;
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            signal_hook::flag::register(signal, stop.clone())?;
        }
        // Before the first thread starts: threads inherit it. Where it is refused, the
        // process runs on any core.
        stay_among(&arguments.among);
        let logs = Logs::start();
        let config = load(&arguments.config)?;
        let wire = join_as(&config.run.name.parse()?, process)?;
        // In lockstep every process runs without a pause; real-time priority would
        // starve the machine.
        let priority = match config.run.is_lockstep() {
            true => 0,
            false => arguments.priority,
        };
        let privileges = Privileges::asked(Ask {
            priority,
            core: arguments.core,
        });
        Ok(Self {
            process,
            config,
            wire,
            clock,
            privileges,
            stop,
            _logs: Some(logs),
        })
    }

    /// Joins as a thread of this program, in place of a process. It asks for no
    /// privileges, leaves signals and logs to the program, and stops when `stop` is
    /// set.
    pub fn embedded(
        process: Process,
        config: Config,
        wire: Wire,
        clock: Clock,
        stop: Arc<AtomicBool>,
    ) -> Self {
        Self {
            process,
            config,
            wire,
            clock,
            privileges: Privileges::asked(Ask {
                priority: 0,
                core: None,
            }),
            stop,
            _logs: None,
        }
    }

    /// The machine's clock, now.
    pub fn now(&self) -> Instant {
        (self.clock)()
    }

    /// The process was asked to stop.
    pub fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Asks the kernel for the privileges of the calling thread, once everything is
    /// allocated. A refusal is logged, and the process runs without that privilege.
    pub fn apply_privileges(&mut self) {
        self.privileges.apply();
        tracing::info!(
            scheduling = %self.privileges.scheduling,
            priority = %self.privileges.priority,
            core = %self.privileges.core,
            memory = %self.privileges.memory,
            "real-time privileges"
        );
    }
}

impl Logs {
    /// Starts a logging thread. Lines are dropped when the disk is too slow, so no disk
    /// delays a process.
    fn start() -> Self {
        let (writer, guard) = tracing_appender::non_blocking(Printable(std::io::stderr()));
        tracing_subscriber::fmt()
            .with_writer(writer)
            .with_ansi(false)
            .with_target(false)
            .with_env_filter(
                tracing_subscriber::EnvFilter::try_from_env("VLAPS_LOG")
                    // Zenoh, in a ROS robot's world, repeats its lines for each attempt to
                    // connect; the world tells the first.
                    .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("info,zenoh=off")),
            )
            .init();
        Self { _guard: guard }
    }
}

/// Joins a run as the process that the supervisor has started. It takes state only from
/// processes that the supervisor's roster names, and waits until the roster names this
/// process too.
///
/// # Errors
/// When shared memory refuses, or no supervisor names this process.
pub fn join_as(run: &RunName, process: Process) -> Result<Wire, WireError> {
    let wire = Wire::join(run, process)?;
    // Only the parent's roster counts: any other process could publish one.
    let supervisor = rustix::process::getppid().map_or(0, |pid| pid.as_raw_nonzero().get());
    wire.follow(supervisor.unsigned_abs())?;
    wire.await_named(process, std::process::id())?;
    Ok(wire)
}

/// Asks the kernel to end this process when the supervisor ends, in any way.
fn die_with_parent() {
    let parent = rustix::process::getppid();
    // The call is refused for invalid signals only.
    let _ = rustix::process::set_parent_process_death_signal(Some(Signal::KILL));
    // The parent may have died before the line above.
    if rustix::process::getppid() != parent {
        std::process::exit(0);
    }
}

/// Runs a process's main function. An error becomes one line and the exit code that the
/// supervisor understands.
pub fn exit_code(process: Process, result: Result<(), SetUpError>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let error = error.to_string();
            // A full disk must not turn the error message into a panic.
            let _ = writeln!(
                std::io::stderr(),
                "vlaps-{process}: {}",
                printable_lines(&error)
            );
            ExitCode::from(SET_UP_FAILED)
        }
    }
}

#[cfg(test)]
mod tests {
    use shm_config::message::Scheduling;

    use super::*;
    use crate::kernel::{own_scheduling, set_fifo};

    #[test]
    fn a_process_that_ends_waits_for_its_log_without_privileges() {
        if set_fifo(1).is_err() {
            println!("skipped: the log of a real-time thread: no real-time priority here");
            return;
        }
        assert_eq!(own_scheduling().0, Scheduling::Fifo);
        let (_, guard) = tracing_appender::non_blocking(std::io::sink());
        drop(Logs { _guard: guard });
        assert_eq!(own_scheduling(), (Scheduling::Ordinary, 0));
    }
}
