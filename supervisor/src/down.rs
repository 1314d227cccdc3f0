//! `down`: asks a running set to stop and waits until it is gone.

use std::fs;
use std::path::Path;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use shm_config::run::{RunName, RunPaths};

use crate::arguments::Down;
use crate::failure::Failure;
use crate::screen::say;
use crate::signals::pause;

/// From look to look.
const LOOK: Duration = Duration::from_millis(50);
/// Looks before the wait is given up: 20 s, twice the default `supervisor.stop_s`
/// and more.
const LOOKS_MAX: u32 = 400;

/// Stops a run.
///
/// # Errors
/// When several runs are alive and none is named, or it does not end.
pub fn down(arguments: &Down) -> Result<(), Failure> {
    let Some(paths) = choose(arguments.run.as_ref())? else {
        say("nothing runs");
        return Ok(());
    };
    let name = paths.name();
    let Some(pid) = paths.supervisor_pid() else {
        say(format_args!("run '{name}' is not running"));
        return Ok(());
    };
    let target = i32::try_from(pid).ok().and_then(Pid::from_raw);
    let asked = target.map(|target| kill_process(target, Signal::TERM));
    match asked {
        Some(Ok(()) | Err(rustix::io::Errno::SRCH)) => {}
        Some(Err(error)) => {
            return Err(Failure::GivenUp(format!(
                "run '{name}': cannot signal process {pid}: {error}"
            )));
        }
        None => {
            return Err(Failure::GivenUp(format!(
                "{}: {pid} is no process id",
                paths.supervisor_file().display()
            )));
        }
    }
    for _ in 0..LOOKS_MAX {
        if paths.supervisor_pid() != Some(pid) {
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

/// The run that is meant: the named one, or the only one alive; `None` when none
/// is.
///
/// # Errors
/// When several are alive and none is named.
pub fn choose(name: Option<&RunName>) -> Result<Option<RunPaths>, Failure> {
    if let Some(name) = name {
        return Ok(Some(RunPaths::new(name.clone())));
    }
    only(living_runs())
}

/// The set that is meant: as [`choose`], but only process sets count, no runs that
/// other programs make for themselves.
///
/// # Errors
/// As [`choose`].
pub fn choose_set(name: Option<&RunName>) -> Result<Option<RunPaths>, Failure> {
    match name {
        Some(_) => choose(name),
        None => only(living_runs().into_iter().filter(is_set).collect()),
    }
}

/// A supervisor drives it; evaluations hold runs of a world alone.
fn is_set(paths: &RunPaths) -> bool {
    let program = |pid| fs::read_link(format!("/proc/{pid}/exe")).ok();
    let program = paths.supervisor_pid().and_then(program);
    let name = program.as_deref().and_then(Path::file_name);
    // Of a program that was built anew meanwhile, the kernel says so behind it.
    name.is_some_and(|name| name.to_string_lossy().starts_with("vlaps-supervisor"))
}

fn only(mut alive: Vec<RunPaths>) -> Result<Option<RunPaths>, Failure> {
    match alive.len() {
        0 => Ok(None),
        1 => Ok(alive.pop()),
        _ => {
            let names: Vec<_> = alive.iter().map(|paths| paths.name().to_string()).collect();
            Err(Failure::Usage(format!(
                "several runs are alive: {}; name one with --run NAME",
                names.join(", ")
            )))
        }
    }
}

/// The user's runs whose supervisor lives.
pub fn living_runs() -> Vec<RunPaths> {
    RunPaths::all()
        .into_iter()
        .filter(|paths| paths.supervisor_pid().is_some())
        .collect()
}
