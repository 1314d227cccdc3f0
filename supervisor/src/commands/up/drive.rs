//! One run: its processes, ports and files are opened, and closed when it has ended.

use std::path::Path;

use shm_config::Instant;
use shm_config::config::Config;
use shm_config::services::Process;
use shm_config::wire::Wire;

use super::supervision::{End, Run};
use crate::Clock;
use crate::cli::failure::Failure;
use crate::machine::idle::IdleBound;
use crate::machine::programs::binaries;
use crate::machine::service::ServiceManager;
use crate::machine::signals::Signals;
use crate::run::journal::Journal;
use crate::run::place::Place;
use crate::run::roster::RosterPublisher;
use crate::set::launch::Launch;
use crate::set::orphans::Orphans;
use crate::set::privileges::Privileges;
use crate::set::process_set::ProcessSet;
use crate::setup::own_programs;
use crate::show::screen::Screen;
use crate::show::summary::Summary;
use crate::takeover::input::{KeySource, TakeoverInput, TakeoverPorts};
use crate::telemetry::foreign::ForeignReports;
use crate::telemetry::ports::Ports;
use crate::telemetry::tally::Tally;
use crate::telemetry::timing;

/// Drives a run to its end: how it ended, what it adds up to, its histograms as CSV, and
/// the screen, which is still open.
///
/// # Errors
/// When a program, a log or a port cannot be opened.
pub(super) fn drive(
    (config, place, folder): (&Config, &Place, &Path),
    keys: Option<KeySource>,
    signals: Signals,
    (clock, started): (Clock, Instant),
) -> Result<(End, Summary, String, Screen), Failure> {
    let binaries = binaries()?;
    let launch = Launch {
        binaries,
        // The processes read this copy and not the one in the run's folder, which a
        // user may edit in the meantime.
        config: place.paths().config_file(),
        privileges: Privileges::of(config),
        programs: own_programs::of_run(config)?,
    };
    let idle = IdleBound::of(config);
    let logs = folder.join("logs");
    let set = ProcessSet::new(config, launch, &logs)?;
    let wire = Wire::join(place.paths().name(), Process::Supervisor)?;
    let ports = Ports::open(&wire)?;
    let roster_port = RosterPublisher::open(&wire)?;
    let takeover = match keys {
        Some(keys) => Some(TakeoverInput::new(keys, TakeoverPorts::open(&wire)?)),
        None => None,
    };
    let now = clock();
    let mut run = Run {
        config,
        place,
        place_looked: now,
        ports,
        takeover,
        roster_port,
        foreign_reports: ForeignReports::default(),
        wire,
        set,
        tally: Tally::begun(started),
        screen: Screen::open(),
        journal: Journal::open(&logs, config, now)?,
        shown: now,
        logs_checked: now,
        is_warned: false,
        judge_trouble: String::new(),
        orphans: Orphans::adopt(),
        service: ServiceManager::of_environment(),
        stops_asked: 0,
        ending: None,
    };
    let grant = idle.grant();
    let bound_us = config.supervisor.cpu_latency_us;
    run.journal.line(
        now,
        &format!("processors wake up within {bound_us} us: {grant}"),
    );
    let end = run.loop_to_the_end(signals, clock);
    let ended = match &end {
        End::Finished => "finished".into(),
        End::Stopped => "stopped".into(),
        End::Killed => "killed".into(),
        End::GivenUp(reason) => format!("given up: {reason}"),
    };
    let summary = Summary::of(config, &run.tally, &run.set, ended).with_idle(&idle);
    let timing = timing::csv(&run.tally);
    Ok((end, summary, timing, run.screen))
}
