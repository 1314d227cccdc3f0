//! `down`: asks a running set to stop and waits until it is gone.

use crate::cli::parsers::Name;
use clap::Args;
use std::time::Duration;

use rustix::process::Signal;
use shm_config::run::RunName;

use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::machine::signals::pause;
use crate::run::selection::select_run;
use crate::run::target::Target;

/// Stop a running set.
#[derive(Debug, Args)]
#[command(
    after_help = "Without --run it stops the one set of this folder: a set whose run.folder \
        (runs/NAME where it was started) lies in the current folder or below it, and which no \
        training or evaluation drives. A set of another folder is never stopped unless it is \
        named.\n\n\
        Exit code 0: it is stopped, or the named run was not running, or nothing runs \
        (status and swap exit 1 then). 1: it does not end, or the process that holds the run is not its supervisor. 2: no run is named, \
        and none of this folder runs though others do, or several do.\n\n\
        Examples:\n  \
        ./vlaps down\n  \
        ./vlaps down --run second"
)]
pub struct Down {
    /// Name of the run; without it, the one set of this folder.
    #[arg(long, value_name = "NAME", value_parser = Name)]
    pub run: Option<RunName>,
}

/// Time between two checks.
const LOOK: Duration = Duration::from_millis(50);
/// Checks before the wait is given up: 20 s, more than twice the default
/// `supervisor.stop_s`.
const LOOKS_MAX: u32 = 400;

/// Stops a run.
///
/// # Errors
/// When no run is named and none belongs to the current folder though others are
/// alive, or it does not end.
pub fn down(arguments: &Down) -> Result<(), Failure> {
    let Some(paths) = select_run(arguments.run.as_ref())? else {
        say("nothing runs");
        return Ok(());
    };
    let name = paths.name();
    let Some(target) = Target::of(&paths)? else {
        say(format_args!("run '{name}' is not running"));
        return Ok(());
    };
    let pid = target.pid();
    target.signal(Signal::TERM).map_err(|error| {
        Failure::GivenUp(format!(
            "run '{name}': cannot signal process {pid}: {error}"
        ))
    })?;
    for _ in 0..LOOKS_MAX {
        // Observers lose sight of the set before its place is free for the next one.
        let holder = paths.holder().ok().flatten();
        if holder.is_none_or(|holder| holder.pid != pid) {
            say(format_args!("run '{name}' is stopped (process {pid})"));
            return Ok(());
        }
        pause(LOOK);
    }
    Err(Failure::GivenUp(format!(
        "run '{name}': process {pid} does not answer; if it is stopped, `kill -CONT {pid}`; else \
         `kill -9 {pid}` ends it and its children, and `./vlaps clean` removes the rest"
    )))
}
