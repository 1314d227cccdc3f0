//! `status`: observes living runs from outside. It creates no run and delays none.

use crate::cli::parsers::Name;
use clap::Args;
use shm_config::run::RunName;
use std::io;
use std::path::PathBuf;

use serde::Serialize;
use shm_config::judged::Judged;
use shm_config::run::{Holder, RunPaths};

use crate::Clock;
use crate::cli::failure::Failure;
use crate::cli::output::Output;
use crate::cli::print::say;
use crate::run::leftovers::print_strangers;
use crate::run::restarts;
use crate::run::selection::alive;
use crate::show::view::View;
use crate::telemetry::foreign;
use crate::telemetry::judge;
use crate::telemetry::late::{self, LateRow};
use crate::telemetry::observe::observe;

/// Show which processes live, whether they are on time, and which driver drives.
#[derive(Debug, Args)]
#[command(after_help = "Exit code 1 says that none runs.\n\n\
        Examples:\n  ./vlaps status\n  ./vlaps status --run second --json status.json")]
pub struct Status {
    /// Name of the run; without it, all of them.
    #[arg(long, value_name = "NAME", value_parser = Name)]
    pub run: Option<RunName>,
    /// Write what is shown to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct Runs {
    runs: Vec<RunStatus>,
}

/// One run.
#[derive(Debug, Serialize)]
struct RunStatus {
    supervisor: u32,
    /// The judge's record; `None` without a judge.
    judge: Option<Judged>,
    /// Why the judge was never asked; left out if it was asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    judge_unasked: Option<&'static str>,
    /// The most late ticks, the most late first.
    late_ticks: Vec<LateRow>,
    /// Processes that the run did not start and that sent in place of its own.
    warnings: Vec<String>,
    #[serde(flatten)]
    view: View,
}

/// Shows the living runs.
///
/// # Errors
/// When none is alive, or one cannot be observed.
pub fn status(arguments: &Status, clock: Clock) -> Result<(), Failure> {
    let json = match &arguments.json {
        Some(path) => Some((path, Output::of_option("--json", path)?)),
        None => None,
    };
    let alive: Vec<_> = match &arguments.run {
        Some(name) => vec![RunPaths::new(name.clone())],
        None => alive()?,
    };
    let (mut runs, mut broken, mut is_closed) = (Vec::new(), false, false);
    for paths in alive {
        // Refuses a folder of another user, with its owner.
        if let Some(Holder { pid, .. }) = paths.holder()? {
            // A process that joined now would keep its place from being cleaned.
            if paths.supervisor_pid() != Some(pid) {
                is_closed = true;
                continue;
            }
            print_strangers(&paths)?;
            let seen = match listen(&paths, pid, clock) {
                Ok(seen) => seen,
                // One run that cannot be observed must not hide the others.
                Err(error) => {
                    let name = paths.name();
                    say(format_args!(
                        "run '{name}' (supervisor process {pid}) cannot be observed: {error}; \
                         `./vlaps down --run {name}` stops it"
                    ));
                    broken = true;
                    continue;
                }
            };
            say(seen.view.headline());
            say(seen.view.table());
            say(format_args!(
                "  {}; supervisor process {pid}",
                seen.view.drive_line()
            ));
            for warning in &seen.warnings {
                say(format_args!("  {warning}"));
            }
            match (seen.judge_unasked, &seen.judge) {
                (Some(reason), _) => say(format_args!("  judge {reason}")),
                (None, Some(judged)) => say(format_args!("  judge {judged}")),
                (None, None) => {}
            }
            runs.push(seen);
        }
    }
    let none = runs.is_empty();
    if let Some((path, output)) = json {
        let text = serde_json::to_string_pretty(&Runs { runs }).map_err(io::Error::other);
        text.and_then(|text| output.write(&(text + "\n")))
            .map_err(|error| Failure::GivenUp(format!("{}: {error}", path.display())))?;
    }
    match (none, &arguments.run) {
        _ if broken => Err(Failure::GivenUp("not every run could be observed".into())),
        (false, _) => Ok(()),
        (true, Some(name)) if is_closed => Err(Failure::GivenUp(format!(
            "run '{name}' is just starting or ending; try again"
        ))),
        (true, Some(name)) => Err(Failure::GivenUp(format!(
            "run '{name}' is not running; `./vlaps up --run {name}` starts it"
        ))),
        (true, None) => Err(Failure::GivenUp(
            "nothing runs; `./vlaps up` starts a run".into(),
        )),
    }
}

fn listen(paths: &RunPaths, supervisor: u32, clock: Clock) -> Result<RunStatus, Failure> {
    let (config, tally) = observe(paths, supervisor, clock)?;
    let judge = judge::read(&config, supervisor);
    Ok(RunStatus {
        supervisor,
        warnings: tally
            .foreigners()
            .map(|foreigner| foreign::warning(foreigner, &tally, paths))
            .collect(),
        judge_unasked: judge::unasked(&config, &tally, judge.as_ref()),
        judge,
        late_ticks: late::most_late(&tally),
        view: View::from_outside(&config, &tally, &restarts::read(paths)),
    })
}
