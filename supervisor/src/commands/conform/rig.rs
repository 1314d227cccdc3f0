//! A run with the tested world, a scripted controller and no other process.

use std::fs;

use runtime::LogFile;
use rustix::process::Signal;
use shm_config::Instant;
use shm_config::config::Config;
use shm_config::message::{
    Episode, Health, HealthState, Message, Observation, Progress, RefusalKind, Timing,
};
use shm_config::run::RunName;
use shm_config::services::{EPISODE, OBSERVATION, PROGRESS, Process, health, timing};
use shm_config::wire::{Subscriber, Wire};
use tempfile::TempDir;

use super::actor::Actor;
use super::order::Order;
use super::pace::Pace;
use super::watched::Watched;
use crate::Clock;
use crate::cli::failure::Failure;
use crate::machine::programs::Executable;
use crate::machine::programs::binaries;
use crate::machine::signals::Signals;
use crate::run::place::Place;
use crate::run::roster::RosterPublisher;
use crate::run::shared_memory::{Need, check_shared_memory, shared_memory};
use crate::set::exit::Exit;
use crate::set::launch::{Launch, Resume, Running};
use crate::set::privileges::Privileges;
use crate::set::table::{ProcessSpec, TABLE};
use crate::setup::own_programs;

/// Time between two reads of the ports, ns. The queue of observations holds 64: a world
/// at 1000 Hz fills it in 64 ms.
const LOOK_NS: u64 = 2_000_000;
/// Lines of the world's log that are shown when it ends by itself.
const LOG_LINES: usize = 6;

/// The reading ends of what a world publishes.
struct Ports {
    observations: Subscriber<Observation>,
    progress: Subscriber<Progress>,
    episodes: Subscriber<Episode>,
    health: Subscriber<Health>,
    timing: Subscriber<Timing>,
}

/// The run. Fields are dropped in this order: the place's files go last.
pub(super) struct Rig {
    pub(super) watched: Watched,
    pub(super) config: Config,
    pub(super) pace: Pace,
    controller: Option<Actor>,
    stranger: Option<Actor>,
    world: Option<Running>,
    ports: Ports,
    roster: RosterPublisher,
    wire: Wire,
    place: Place,
    launch: Launch,
    log: LogFile,
    row: &'static ProcessSpec,
    signals: Signals,
    clock: Clock,
    _folder: TempDir,
}

impl Rig {
    /// Opens the run; no process is started.
    ///
    /// # Errors
    /// When the program cannot be started, or the run cannot be opened.
    pub(super) fn open(config: Config, clock: Clock) -> Result<Self, Failure> {
        let failed = |error: std::io::Error| Failure::GivenUp(format!("a run's folder: {error}"));
        let folder = TempDir::with_prefix("vlaps-conform-").map_err(failed)?;
        let file = folder.path().join("config.toml");
        let text = toml::to_string(&config)
            .map_err(|error| Failure::Usage(format!("the configuration: {error}")))?;
        fs::write(&file, text).map_err(failed)?;
        let launch = Launch {
            binaries: binaries()?,
            config: file,
            privileges: Privileges::of(&config),
            programs: own_programs::of_run(&config)?,
        };
        let limit_bytes = u64::from(config.supervisor.log_mb) << 20;
        let log = LogFile::create(folder.path(), "world", limit_bytes).map_err(failed)?;
        let name: RunName = config
            .run
            .name
            .parse()
            .map_err(|error| Failure::Usage(format!("the run's name: {error}")))?;
        let signals = Signals::install()
            .map_err(|error| Failure::GivenUp(format!("cannot take over signals: {error}")))?;
        let (place, _) = Place::take(name)?;
        check_shared_memory(shared_memory()?.0, &Need::of(&config))?;
        let wire = Wire::join(place.paths().name(), Process::Supervisor)?;
        let roster = RosterPublisher::open(&wire)?;
        let ports = Ports {
            observations: wire.every(OBSERVATION)?,
            progress: wire.subscriber(PROGRESS)?,
            episodes: wire.subscriber(EPISODE)?,
            health: wire.subscriber(health(Process::World))?,
            timing: wire.subscriber(timing(Process::World))?,
        };
        let row = TABLE
            .iter()
            .find(|row| row.process == Process::World)
            .ok_or_else(|| Failure::GivenUp("no world in the process table".into()))?;
        Ok(Self {
            watched: Watched::new(&config),
            pace: Pace::of(&config),
            config,
            controller: None,
            stranger: None,
            world: None,
            ports,
            roster,
            wire,
            place,
            launch,
            log,
            row,
            signals,
            clock,
            _folder: folder,
        })
    }

    /// The machine's clock, now.
    pub(super) fn now(&self) -> Instant {
        (self.clock)()
    }

    /// Starts the world, at an episode when it is a restart.
    ///
    /// # Errors
    /// When the system cannot start it.
    pub(super) fn start_world(&mut self, resume: Resume) -> Result<(), Failure> {
        // The newest build of a program that is being written.
        let executable = Executable::at(self.launch.binary(self.row));
        let started = (self.launch).start(self.row, &executable, &mut self.log, resume);
        let world = started.map_err(|error| {
            let program = self.launch.binary(self.row);
            Failure::Usage(format!("{}: cannot start: {error}", program.display()))
        })?;
        self.roster.name(&self.wire, Process::World, world.pid());
        self.world = Some(world);
        self.watched.begin();
        Ok(())
    }

    /// Sends the world a signal.
    pub(super) fn signal_world(&self, signal: Signal) {
        if let Some(world) = &self.world {
            world.signal(signal);
        }
    }

    /// How the world has ended; `None` while it runs.
    pub(super) fn world_exit(&mut self) -> Option<Exit> {
        let exit = self.world.as_mut()?.reap()?;
        self.world = None;
        // What it published last is still in the queues.
        self.read();
        Some(exit)
    }

    /// The end of the world's log, on one line.
    pub(super) fn last_lines(&self) -> String {
        match self.log.last_lines(LOG_LINES).join(" | ") {
            lines if lines.is_empty() => "it wrote nothing".into(),
            lines => lines,
        }
    }

    /// Starts a scripted controller as the run's, in place of the one before.
    ///
    /// # Errors
    /// When it cannot be started.
    pub(super) fn start_controller(&mut self) -> Result<(), Failure> {
        self.controller = None;
        let actor = Actor::start(self.place.paths().name())?;
        self.roster
            .name(&self.wire, Process::Controller, actor.pid());
        self.controller = Some(actor);
        Ok(())
    }

    /// Kills the controller.
    pub(super) fn kill_controller(&mut self) {
        self.controller = None;
    }

    /// Orders the controller, if there is one.
    ///
    /// # Errors
    /// When it has ended.
    pub(super) fn order(&mut self, order: Order) -> Result<(), Failure> {
        match &mut self.controller {
            Some(actor) => actor.order(order),
            None => Ok(()),
        }
    }

    /// Starts a process that sends commands although the run did not start it.
    ///
    /// # Errors
    /// When it cannot be started.
    pub(super) fn start_stranger(&mut self, order: Order) -> Result<(), Failure> {
        let mut actor = Actor::start(self.place.paths().name())?;
        actor.order(order)?;
        self.stranger = Some(actor);
        Ok(())
    }

    /// Ends that process.
    pub(super) fn end_stranger(&mut self) {
        self.stranger = None;
    }

    /// Watches until `is_done`, or for `limit_s` seconds; returns whether it was done.
    ///
    /// # Errors
    /// When the world ends meanwhile, or a signal asks to stop.
    pub(super) fn watch(
        &mut self,
        limit_s: f64,
        mut is_done: impl FnMut(&mut Self) -> Result<bool, Failure>,
    ) -> Result<bool, Failure> {
        let until = self.now().after_ns((limit_s * 1e9) as u64);
        loop {
            self.read();
            if is_done(self)? {
                return Ok(true);
            }
            if let Some(exit) = self.world_exit() {
                return Err(Failure::GivenUp(format!(
                    "the world ended by itself ({exit}): {}",
                    self.last_lines()
                )));
            }
            if self.signals.take_stops() > 0 {
                return Err(Failure::GivenUp("stopped by a signal".into()));
            }
            if self.now() >= until {
                return Ok(false);
            }
            self.signals.wait(LOOK_NS);
        }
    }

    /// Watches for a time, s.
    ///
    /// # Errors
    /// As [`Rig::watch`].
    pub(super) fn watch_for(&mut self, time_s: f64) -> Result<(), Failure> {
        self.watch(time_s, |_| Ok(false)).map(drop)
    }

    /// How many messages the world has refused for this reason, as its health says.
    pub(super) fn refused(&self, kind: RefusalKind) -> u64 {
        let health = self.watched.health.as_ref();
        health.map_or(0, |health| health.refused[kind.code() as usize])
    }

    /// Reads all ports.
    fn read(&mut self) {
        self.roster.update_connections();
        let ports = &mut self.ports;
        ports.observations.update_connections();
        ports.progress.update_connections();
        ports.episodes.update_connections();
        ports.health.update_connections();
        ports.timing.update_connections();
        while let Some(observation) = ports.observations.receive() {
            // The clock is read after the message; otherwise the message would seem to
            // come from the future.
            self.watched.see(&observation, (self.clock)());
        }
        self.watched.lost = ports.observations.lost();
        while let Some(progress) = ports.progress.receive() {
            self.watched.progress(&progress);
        }
        while let Some(episode) = ports.episodes.receive() {
            self.watched.episodes.push(episode);
        }
        while let Some(health) = ports.health.receive() {
            self.watched.hear(health, (self.clock)());
        }
        let watched = &mut self.watched;
        while let Some((count, is_valid)) = ports
            .timing
            .visit(|timing| (timing.execution.count, timing.check().is_ok()))
        {
            watched.timings += u64::from(is_valid);
            watched.timed = count;
        }
    }

    /// Whether the world has reported that it is set up.
    pub(super) fn is_ready(&self) -> bool {
        let state = self.watched.health.as_ref();
        let state = state.and_then(|health| HealthState::from_code(health.state));
        matches!(state, Some(HealthState::Ready | HealthState::Running))
    }
}
