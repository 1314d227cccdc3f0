//! The runs of this user, and the one that a command means.

use shm_config::run::{RunName, RunPaths};

use crate::cli::failure::Failure;

/// The run that a command applies to: the named one, or the only living set of the
/// current folder; `None` when no set runs at all.
///
/// A set belongs to the current folder when its `run.folder`, links resolved, lies in the
/// current folder or below it, and it was started without `--parent`, which a training or
/// an evaluation passes.
///
/// # Errors
/// When no run is named, and several belong to this folder, or none does and others run.
pub fn select_run(name: Option<&RunName>) -> Result<Option<RunPaths>, Failure> {
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

/// The runs as a list, each with its folder or parent.
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

/// The user's runs with a living supervisor.
///
/// # Errors
/// When the folder of the user's runs belongs to another user.
pub fn alive() -> Result<Vec<RunPaths>, Failure> {
    let lives = |paths: &RunPaths| paths.supervisor_pid().is_some();
    Ok(RunPaths::all()?.into_iter().filter(lives).collect())
}

/// As [`alive`]; empty where that folder cannot be used.
pub fn living_runs() -> Vec<RunPaths> {
    alive().unwrap_or_default()
}
