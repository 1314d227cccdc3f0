//! Answers each observation of one world process with a command.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::time::Duration;

use shm_config::config::Config;
use shm_config::message::{Command, Episode, Header, Message, Observation};
use shm_config::services::{COMMAND, EPISODE, OBSERVATION, Process};
use shm_config::wire::{Doorbell, Publisher, Subscriber, Wire, WireError};
use supervisor::run::place::Place;
use supervisor::run::roster::RosterPublisher;
use supervisor::run::shared_memory::{Need, check_shared_memory, shared_memory};
use supervisor::set::launch::Program;

use super::world::WorldProcess;
use crate::episodes::DrivenEpisode;
use stack::Clock;
use stack::driver::{DriverKind, EpisodeDriver};

/// Maximum sleep between two checks for the world's end and for a stop request.
const NAP: Duration = Duration::from_millis(20);
/// A world that sends nothing for this time has hung: many times longer than its start
/// and its longest reset, ns.
const SILENCE_NS: u64 = 180_000_000_000;

/// The controller's ports of the run.
struct Ports {
    bell: Doorbell,
    observations: Subscriber<Observation>,
    episodes: Subscriber<Episode>,
    commands: Publisher<Command>,
}

impl Ports {
    fn open(wire: &Wire) -> Result<Ports, WireError> {
        Ok(Ports {
            bell: wire.doorbell(Process::Controller)?,
            observations: wire.subscriber(OBSERVATION)?,
            episodes: wire.subscriber(EPISODE)?,
            commands: wire.publisher(COMMAND)?,
        })
    }

    /// Connects to a world that has joined, between two ticks.
    fn update_connections(&mut self) {
        self.observations.update_connections();
        self.episodes.update_connections();
        self.commands.update_connections();
    }
}

/// Drives the episodes of one world until they are done or `stop` is set.
///
/// # Errors
/// If the run cannot be created, or the world ends early or sends nothing.
pub fn drive(
    kind: DriverKind,
    (config, program): (&Config, &Program),
    clock: Clock,
    stop: &AtomicBool,
    send: &Sender<DrivenEpisode>,
) -> anyhow::Result<()> {
    // Dropped in reverse order: the run's files are removed after all ports are closed.
    let (place, _) = Place::take(config.run.name.parse()?)?;
    check_shared_memory(shared_memory()?.0, &Need::of(config))?;
    let wire = Wire::join(place.paths().name(), Process::Controller)?;
    let mut roster = RosterPublisher::open(&wire)?;
    roster.name(&wire, Process::Controller, std::process::id());
    let mut ports = Ports::open(&wire)?;
    let mut world = WorldProcess::start(program, config, &place.paths().dir())?;
    roster.name(&wire, Process::World, world.pid());
    let mut wheel = Wheel {
        driver: EpisodeDriver::new(kind, config, clock)?,
        begun: None,
        first_seed: config.run.seed,
    };
    let mut left = config.run.episodes;
    let mut heard = clock();
    while left > 0 && !stop.load(Ordering::Relaxed) {
        // Checked before reading: all messages that the world sent before its end are there.
        let exit = world.ended()?;
        while let Some(episode) = ports.episodes.receive() {
            left = left.saturating_sub(1);
            let driven = DrivenEpisode {
                episode,
                planning_us: wheel.driver.take_planning_us(),
            };
            if send.send(driven).is_err() {
                return Ok(());
            }
        }
        if let Some(observation) = ports.observations.newest(Message::check) {
            heard = clock();
            ports.commands.send(&mut wheel.command(observation));
        } else if let (Some(exit), true) = (exit, left > 0) {
            return Err(world.lost(&exit).into());
        } else if clock().since_ns(heard) > SILENCE_NS {
            return Err(world.lost(&"no message for minutes").into());
        } else {
            ports.bell.wait(NAP);
        }
        ports.update_connections();
        roster.update_connections();
    }
    Ok(())
}

/// A driver that is reset at the begin of each episode.
struct Wheel {
    driver: EpisodeDriver,
    /// Header of the first observation of the episode.
    begun: Option<Header>,
    /// Seed of the run's first episode.
    first_seed: u64,
}

impl Wheel {
    /// The command for an observation. The driver sees headers as if the run began with this
    /// episode, as in the built-in world; the command has the world's own header.
    fn command(&mut self, mut observation: Observation) -> Command {
        let header = observation.header;
        let first = match self.begun {
            Some(first) if first.episode == header.episode => first,
            _ => {
                let index = u64::from(header.episode);
                self.driver.begin(self.first_seed.wrapping_add(index));
                *self.begun.insert(header)
            }
        };
        observation.header = Header {
            tick: header.tick - first.tick,
            taken_ns: header.taken_ns - first.taken_ns,
            ..Header::default()
        };
        let mut command = self.driver.answer(&observation);
        command.header = Header {
            tick: header.tick,
            taken_ns: header.taken_ns,
            episode: header.episode,
            ..Header::default()
        };
        command
    }
}
