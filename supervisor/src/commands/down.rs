//! `down`: asks a running set to stop and waits until it is gone.

use std::time::Duration;

use rustix::process::Signal;
use shm_config::run::{RunName, RunPaths};

use crate::arguments::Down;
use crate::cli::failure::Failure;
use crate::machine::signals::pause;
use crate::run::target::Target;
use crate::show::screen::say;

/// From look to look.
const LOOK: Duration = Duration::from_millis(50);
/// Looks before the wait is given up: 20 s, twice the default `supervisor.stop_s`
/// and more.
const LOOKS_MAX: u32 = 400;

/// Stops a run.
///
/// # Errors
/// When no run is named and none belongs to the current folder though others are
/// alive, or it does not end.
pub fn down(arguments: &Down) -> Result<(), Failure> {
    let Some(paths) = choose(arguments.run.as_ref())? else {
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

/// The run that is meant: the named one, or the only set of the current folder that
/// is alive; `None` when nothing runs at all.
///
/// A set is of the current folder when its `run.folder`, links resolved, lies in
/// the current folder or below it, and a user has started it: no training or
/// evaluation, which pass `--parent`.
///
/// # Errors
/// When none is named, and several are of this folder, or none is and others run.
pub fn choose(name: Option<&RunName>) -> Result<Option<RunPaths>, Failure> {
    if let Some(name) = name {
        return Ok(Some(RunPaths::new(name.clone())));
    }
    let here = std::env::current_dir().map_err(|error| {
        Failure::GivenUp(format!(
            "the current folder: {error}; name a run with --run"
        ))
    })?;
    let (mut own, others): (Vec<_>, Vec<_>) = alive()?.into_iter().partition(|paths| {
        let origin = paths.origin();
        origin.is_some_and(|origin| origin.parent.is_none() && origin.folder.starts_with(&here))
    });
    match (own.len(), others.is_empty()) {
        (0, true) => Ok(None),
        (1, _) => Ok(own.pop()),
        (0, false) => Err(Failure::Usage(format!(
            "no set of this folder runs ({}); others do: {}; name one with --run NAME",
            here.display(),
            listed(&others)
        ))),
        _ => Err(Failure::Usage(format!(
            "several sets of this folder run: {}; name one with --run NAME",
            listed(&own)
        ))),
    }
}

/// Each run with where it belongs.
fn listed(runs: &[RunPaths]) -> String {
    let shown = runs.iter().map(|paths| {
        let name = paths.name();
        match paths.origin() {
            None => name.to_string(),
            Some(origin) => match origin.parent {
                None => format!("{name} (of {})", origin.folder.display()),
                Some(parent) => format!("{name} (of process {parent}, which drives it)"),
            },
        }
    });
    shown.collect::<Vec<_>>().join(", ")
}

/// The user's runs whose supervisor lives.
///
/// # Errors
/// When the folder of the user's runs belongs to another user.
pub fn alive() -> Result<Vec<RunPaths>, Failure> {
    let lives = |paths: &RunPaths| paths.supervisor_pid().is_some();
    Ok(RunPaths::all()?.into_iter().filter(lives).collect())
}

/// The same; none where that folder cannot be used.
pub fn living_runs() -> Vec<RunPaths> {
    alive().unwrap_or_default()
}
