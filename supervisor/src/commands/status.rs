//! `status`: looks at living runs from outside. It never makes a run and never
//! keeps one from anything.

use std::io;
use std::time::Duration;

use serde::Serialize;
use shm_config::config::{self, Config};
use shm_config::judged::Judged;
use shm_config::run::{Holder, RunPaths};
use shm_config::services::Process;
use shm_config::wire::Wire;

use crate::Clock;
use crate::arguments::Status;
use crate::cli::failure::Failure;
use crate::cli::output::Output;
use crate::commands::clean::{clean_run, tell_strangers};
use crate::commands::down::alive;
use crate::machine::memory::Memory;
use crate::machine::signals::pause;
use crate::run::restarts;
use crate::run::roster;
use crate::set::table::rows;
use crate::show::screen::say;
use crate::show::view::View;
use crate::telemetry::judge;
use crate::telemetry::late::{self, LateRow};
use crate::telemetry::ports::{Depth, Ports};
use crate::telemetry::tally::{ProcessTally, Tally};

/// How long everybody has to say something, ns. A process speaks at least every
/// 100 ms; ten of those.
const LISTEN_NS: u64 = 1_000_000_000;
/// From look to look.
const LOOK: Duration = Duration::from_millis(20);

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct Runs {
    runs: Vec<Seen>,
}

/// One run.
#[derive(Debug, Serialize)]
struct Seen {
    supervisor: u32,
    /// What the judge was asked and said; `None` where nobody judges.
    judge: Option<Judged>,
    /// Why it was never asked; left out where it was.
    #[serde(skip_serializing_if = "Option::is_none")]
    judge_unasked: Option<&'static str>,
    /// The ticks that were latest, the latest first.
    late_ticks: Vec<LateRow>,
    /// Processes that the run did not start and that sent in the place of its own.
    warnings: Vec<String>,
    #[serde(flatten)]
    view: View,
}

/// Shows the living runs.
///
/// # Errors
/// When none is alive, or one cannot be looked at.
pub fn status(arguments: &Status, clock: Clock) -> Result<(), Failure> {
    let json = match &arguments.json {
        Some(path) => Some((path, Output::of_option("--json", path)?)),
        None => None,
    };
    let alive: Vec<_> = match &arguments.run {
        Some(name) => vec![RunPaths::new(name.clone())],
        None => alive()?,
    };
    let (mut runs, mut broken) = (Vec::new(), false);
    for paths in alive {
        if let Some(Holder { pid, .. }) = paths.holder()? {
            tell_strangers(&paths)?;
            let seen = match listen(&paths, pid, clock) {
                Ok(seen) => seen,
                // One broken run must not hide the others.
                Err(error) => {
                    let name = paths.name();
                    say(format_args!(
                        "run '{name}' (supervisor process {pid}) cannot be looked at: {error}; \
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
        _ if broken => Err(Failure::GivenUp("not every run could be looked at".into())),
        (false, _) => Ok(()),
        (true, Some(name)) => Err(Failure::GivenUp(format!(
            "run '{name}' is not running; `./vlaps up --run {name}` starts it"
        ))),
        (true, None) => Err(Failure::GivenUp(
            "nothing runs; `./vlaps up` starts a run".into(),
        )),
    }
}

fn listen(paths: &RunPaths, supervisor: u32, clock: Clock) -> Result<Seen, Failure> {
    let (config, tally) = look(paths, supervisor, clock)?;
    let judge = judge::read(&config, supervisor);
    Ok(Seen {
        supervisor,
        warnings: tally.foreigners().map(roster::warning).collect(),
        judge_unasked: judge::unasked(&config, &tally, judge.as_ref()),
        judge,
        late_ticks: late::latest(&tally),
        view: View::from_outside(&config, &tally, &restarts::read(paths)),
    })
}

/// Listens to a living run for a while, and asks the kernel about its processes.
///
/// # Errors
/// When it is just starting or ending, or shared memory refuses.
pub fn look(paths: &RunPaths, supervisor: u32, clock: Clock) -> Result<(Config, Tally), Failure> {
    let config = config::load(&paths.config_file()).map_err(|_| {
        Failure::GivenUp(format!(
            "run '{}' is just starting or ending; try again",
            paths.name()
        ))
    })?;
    let mut tally = Tally::default();
    let heard = hear((paths, supervisor), &config, &mut tally, clock);
    // The run may have ended meanwhile; then this process kept its place.
    if paths.supervisor_pid().is_none() {
        clean_run(paths)?;
    }
    heard?;
    for process in rows(&config).map(|row| row.process) {
        let said = tally.process(process).and_then(ProcessTally::newest);
        let Some(pid) = said.map(|health| health.header.producer) else {
            continue;
        };
        tally.count_threads(process, pid);
        if let Some(memory) = Memory::of(pid) {
            tally.count_memory(process, memory);
        }
    }
    Ok((config, tally))
}

fn hear(
    (paths, supervisor): (&RunPaths, u32),
    config: &Config,
    tally: &mut Tally,
    clock: Clock,
) -> Result<(), Failure> {
    let wire = Wire::join(paths.name(), Process::Supervisor)?;
    wire.follow(supervisor)?;
    wire.await_named(Process::Supervisor, supervisor)?;
    let mut ports = Ports::open(&wire, config, Depth::Newest)?;
    let begun = clock();
    while clock().since_ns(begun) < LISTEN_NS {
        ports.drain(tally);
        // A timing alone says nothing of how it is.
        let said = |process| tally.process(process).and_then(ProcessTally::newest);
        let all = rows(config).all(|row| said(row.process).is_some());
        if all && tally.steps.newest.is_some() && tally.progress.is_some() {
            break;
        }
        pause(LOOK);
    }
    Ok(())
}
