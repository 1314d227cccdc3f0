//! `conform`: tests the promises of any world program.
//!
//! It starts the world in a run of its own, as `up` does, with a scripted controller in
//! place of planner and controller. It is a command of the supervisor, and not of `lab`
//! or `bench`, because launch, roster and ports are here, and because each installation
//! that can start a run has the supervisor.
//!
//! | module | holds |
//! |---|---|
//! | `order` | what the scripted controller sends |
//! | `actor` | the scripted controller, a process of its own |
//! | `rig` | the run: world, controller, ports |
//! | `watched` | what the world has published |
//! | `pace` | how fast the car is tested, by its own limits |
//! | `promises` | the tests |
//! | `report` | the table |

mod actor;
mod order;
mod pace;
mod promises;
mod report;
mod rig;
mod watched;

use std::io;
use std::path::PathBuf;

use clap::Args;
use shm_config::config::{Clock as RunClock, Config, GateMode, Keep};
use shm_config::run::RunName;

use crate::Clock;
use crate::cli::failure::Failure;
use crate::cli::output::Output;
use crate::cli::parsers::Name;
use crate::cli::print::say;
use crate::commands::up::arguments::{Up, UpWorld, WorldOrProgram};
use crate::commands::up::settings;
use crate::run::folder::cannot_write;
use report::Report;
use rig::Rig;

/// Test the promises of a world program.
#[derive(Debug, Args)]
#[command(
    after_help = "The world drives some ten metres forward in real time: give it a free course \
        of twenty. It is told to drive, to steer, and nothing; it gets invalid commands, \
        commands of a foreign process, and a new controller; it is killed and started again. \
        Exit code 0: every promise is held; 1: one is not; 2: the test could not run.\n\n\
        Examples:\n  \
        ./vlaps conform ./target/release/examples/template\n  \
        ./vlaps conform ./my-robot --vehicle my-car.toml --json conform.json\n  \
        ./vlaps conform sim"
)]
pub struct Conform {
    /// The world: a program, as a path with a '/'; or sim, metadrive, ir-sim, f1tenth or
    /// commonroad.
    #[arg(value_name = "PROGRAM", value_parser = WorldOrProgram, required_unless_present = "act")]
    pub program: Option<UpWorld>,
    /// Configuration file; vlaps.toml of the current folder is read when present.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Vehicle file of the car, such as vehicles/truck.toml; its keys replace those of the
    /// configuration file.
    #[arg(long, value_name = "FILE")]
    pub vehicle: Option<PathBuf>,
    /// Override any key of the configuration; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Write the rows to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Be the scripted controller of this run.
    #[arg(long, hide = true, value_parser = Name)]
    pub act: Option<RunName>,
}

/// Tests a world.
///
/// # Errors
/// When a promise is not held, or the test could not run.
pub fn conform(arguments: &Conform, clock: Clock) -> Result<(), Failure> {
    if let Some(run) = &arguments.act {
        return actor::act(run, clock);
    }
    let config = resolve(arguments)?;
    let json = match &arguments.json {
        Some(path) => Some((path, Output::of_option("--json", path)?)),
        None => None,
    };
    let mut report = Report {
        world: match &arguments.program {
            Some(UpWorld::Program(path)) => path.display().to_string(),
            Some(UpWorld::Simulator(choice)) => choice.word().into(),
            None => String::new(),
        },
        rate_hz: config.run.rate_hz,
        rows: Vec::new(),
    };
    say(format_args!(
        "testing {} at {} Hz; this takes half a minute",
        report.world, report.rate_hz
    ));
    let mut rig = Rig::open(config, clock).map_err(could_not_run)?;
    let tested = test(&mut rig, &mut report);
    drop(rig);
    say(report.to_string().trim_end());
    if let Some((path, output)) = json {
        let text = serde_json::to_string_pretty(&report).map_err(io::Error::other);
        let written = text.and_then(|text| output.write(&text));
        written.map_err(|error| cannot_write(path, &error))?;
    }
    tested.map_err(could_not_run)?;
    match report.broken() {
        0 => Ok(()),
        broken => Err(Failure::GivenUp(format!(
            "{broken} of {} promises are not held",
            report.rows.len()
        ))),
    }
}

/// Every failure of the test itself ends with exit code 2.
fn could_not_run(failure: Failure) -> Failure {
    match failure {
        Failure::Usage(_) | Failure::Config(_) => failure,
        other => Failure::Usage(format!("the test could not run: {other}")),
    }
}

/// The configuration of the run: that of an `up` with the scripted drive's own keys.
fn resolve(arguments: &Conform) -> Result<Config, Failure> {
    let mut config = settings::resolve(&Up {
        world: arguments.program.clone(),
        config: arguments.config.clone(),
        vehicle: arguments.vehicle.clone(),
        overrides: arguments.overrides.clone(),
        ..Up::default()
    })?;
    config.run.name = format!("conform-{}", std::process::id());
    config.run.clock = RunClock::RealTime;
    config.run.episodes = 0;
    config.run.duration_s = 0.0;
    config.gate.mode = GateMode::Expert;
    config.learner.enabled = false;
    config.record.keep = Keep::Nothing;
    // The scripted drive sees nothing: an empty road for the worlds that have traffic.
    config.world.traffic_density = 0.0;
    config.world.accident_probability = 0.0;
    config
        .validated()
        .map_err(|error| Failure::Usage(error.to_string()))
}

/// Tests all promises. One that is not held ends the test when the others depend on it.
fn test(rig: &mut Rig, report: &mut Report) -> Result<(), Failure> {
    if !promises::ready(rig, report)? {
        return Ok(());
    }
    // A machine that is killed while it drives goes on driving.
    let driven = drive(rig, report).and_then(|()| promises::stands(rig));
    promises::publishes(rig, report);
    if let Err(Failure::GivenUp(why)) = driven {
        report.add("runs until it is asked to end", false, why);
        return Ok(());
    }
    driven?;
    promises::resumes(rig, report)?;
    promises::ends(rig, report)
}

/// The promises that need a car that moves.
fn drive(rig: &mut Rig, report: &mut Report) -> Result<(), Failure> {
    if !promises::obeys_pedal(rig, report)? {
        return Ok(());
    }
    promises::obeys_steering(rig, report)?;
    promises::brakes_on_silence(rig, report)?;
    promises::refuses(rig, report)?;
    promises::brakes_while_contested(rig, report)?;
    promises::survives_controller(rig, report)
}
