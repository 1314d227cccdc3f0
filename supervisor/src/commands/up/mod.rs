//! `up`: starts a set, supervises it, stops it and prints its summary.

pub mod arguments;
mod drive;
mod report;
pub mod settings;
mod supervision;

use std::io;
use std::path::Path;

use shm_config::config::GateMode;

use crate::Clock;
use crate::cli::failure::Failure;
use crate::cli::output::Output;
use crate::cli::print::say;
use crate::machine::parent;
use crate::machine::signals::Signals;
use crate::run::folder::{cannot_write, keep, prepare_folder};
use crate::run::leftovers::print_strangers;
use crate::run::place::Place;
use crate::run::shared_memory::{Need, check_shared_memory, shared_memory};
use crate::show::layout::say_fitted;
use crate::show::summary::Summary;
use crate::takeover::input::KeySource;
use crate::telemetry::{late, timing};
use arguments::Up;
use drive::drive;
use supervision::End;

/// Drives a run to its end.
///
/// # Errors
/// When the configuration is wrong, the run cannot start, or it had to be given up. In all
/// cases its shared memory is removed.
pub fn up(arguments: &Up, clock: Clock) -> Result<(), Failure> {
    let started = clock();
    if let Some(parent) = arguments.parent {
        parent::end_with(parent)?;
    }
    let config = settings::resolve(arguments)?;
    shm_config::secret::take_named(&config.vlm.key_env).map_err(Failure::secrets)?;
    let json = match &arguments.json {
        Some(path) => Some((path, Output::of_option("--json", path)?)),
        None => None,
    };
    let no_signals =
        |error: io::Error| Failure::GivenUp(format!("cannot take over signals: {error}"));
    let signals = Signals::install().map_err(no_signals)?;
    if config.gate.mode == GateMode::Human {
        signals.stop_on_quit().map_err(no_signals)?;
    }
    // Dropping it restores the terminal on every way out of this function.
    let keys = KeySource::of(&config, arguments.keys.as_deref())?;
    let name = config
        .run
        .name
        .parse()
        .map_err(|error| Failure::Usage(format!("{error}")))?;
    let (place, leftovers) = Place::take(name)?;
    if leftovers.files > 0 {
        say(format_args!(
            "removed what a killed run '{}' left: {} files, {} KB of shared memory",
            config.run.name,
            leftovers.files,
            leftovers.bytes >> 10
        ));
    }
    print_strangers(place.paths())?;
    check_shared_memory(shared_memory()?.0, &Need::of(&config))?;
    let folder = prepare_folder(&config, &place, arguments.parent)?;
    let late = signals.late();
    let run = (&config, &place, folder.path());
    let (end, summary, timing, screen) = drive(run, keys, signals, (clock, started))?;
    drop(place);
    // The set has ended: from here on a signal ends this process, even while it waits for a
    // terminal or a pipe.
    late.end_at_once();
    screen.close();
    // The screen comes first: a full disk may refuse the files.
    tell(&summary, arguments, folder.path());
    let timing = keep(&folder, timing::FILE, Ok(timing));
    let kept = keep(&folder, "summary.json", summary.text());
    // It may lie on another disk, so it is written before an earlier error is returned.
    if let Some((path, output)) = json {
        let written = summary.text().and_then(|text| output.write(&text));
        written.map_err(|error| cannot_write(path, &error))?;
    }
    timing.and(kept)?;
    match end {
        End::Finished | End::Stopped => Ok(()),
        End::Killed => Err(Failure::Killed {
            signal: late.last(),
        }),
        End::GivenUp(reason) => Err(Failure::GivenUp(reason)),
    }
}

/// Prints the summary, and the folder of the run.
fn tell(summary: &Summary, arguments: &Up, folder: &Path) {
    match summary.ticks {
        0 => say(format_args!(
            "\nrun {}: {}; it drove no tick",
            summary.run, summary.ended
        )),
        _ => say_fitted(&format!("\n{summary}")),
    }
    if arguments.late_ticks {
        say_fitted(&late::table(&summary.late_ticks));
    }
    say(format_args!("logs and summary in {}", folder.display()));
}
