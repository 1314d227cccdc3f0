//! The wheel of one world process: a command for every observation.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::time::Duration;

use hdrhistogram::Histogram;
use shm_config::config::Config;
use shm_config::message::{Command, Episode, Header, Message, Observation};
use shm_config::services::{COMMAND, EPISODE, OBSERVATION, Process};
use shm_config::wire::{Doorbell, Publisher, Subscriber, Wire, WireError};
use supervisor::run::place::Place;
use supervisor::run::roster::RosterPublisher;
use supervisor::run::shared_memory::{Need, check_shared_memory, shared_memory};
use supervisor::set::launch::Script;

use super::world::WorldProcess;
use stack::Clock;
use stack::driver::{DriverKind, EpisodeDriver};

/// How long to sleep at most before looking for the world's end and for a stop.
const NAP: Duration = Duration::from_millis(20);
/// A world that says nothing for this long has hung: many times what its start
/// and its longest reset take, ns.
const SILENCE_NS: u64 = 180_000_000_000;

/// The controller's end of the run.
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

    /// Connects to the world that came, between ticks.
    fn update_connections(&mut self) {
        self.observations.update_connections();
        self.episodes.update_connections();
        self.commands.update_connections();
    }
}

/// Drives the episodes of one world, until they are done or `stop` is set.
///
/// # Errors
/// When the run cannot be made, or the world ends or falls silent before.
pub fn drive(
    kind: DriverKind,
    (config, script): (&Config, &Script),
    clock: Clock,
    stop: &AtomicBool,
    send: &Sender<Episode>,
) -> anyhow::Result<Histogram<u64>> {
    // Dropped in the reverse order: the place is left empty when all have gone.
    let (place, _) = Place::take(config.run.name.parse()?)?;
    check_shared_memory(shared_memory()?.0, &Need::of(config))?;
    let wire = Wire::join(place.paths().name(), Process::Controller)?;
    let mut roster = RosterPublisher::open(&wire)?;
    roster.name(&wire, Process::Controller, std::process::id());
    let mut ports = Ports::open(&wire)?;
    let mut world = WorldProcess::start(script, config, &place.paths().dir())?;
    roster.name(&wire, Process::World, world.pid());
    let mut wheel = Wheel {
        driver: EpisodeDriver::new(kind, config, clock)?,
        begun: None,
        first_seed: config.run.seed,
    };
    let mut left = config.run.episodes;
    let mut heard = clock();
    while left > 0 && !stop.load(Ordering::Relaxed) {
        // Looked at first: what it said before it ended is all there by then.
        let exit = world.ended()?;
        while let Some(episode) = ports.episodes.receive() {
            left = left.saturating_sub(1);
            if send.send(episode).is_err() {
                return Ok(wheel.driver.planning_us().clone());
            }
        }
        if let Some(observation) = ports.observations.newest(Message::check) {
            heard = clock();
            ports.commands.send(&mut wheel.command(observation));
        } else if let (Some(exit), true) = (exit, left > 0) {
            return Err(world.lost(&exit).into());
        } else if clock().since_ns(heard) > SILENCE_NS {
            return Err(world.lost(&"silent for minutes").into());
        } else {
            ports.bell.wait(NAP);
        }
        ports.update_connections();
        roster.update_connections();
    }
    Ok(wheel.driver.planning_us().clone())
}

/// A driver that starts anew with every episode.
struct Wheel {
    driver: EpisodeDriver,
    /// Header of the episode's first observation.
    begun: Option<Header>,
    /// Seed of the run's first episode.
    first_seed: u64,
}

impl Wheel {
    /// The command for an observation. The driver sees the headers of a run of
    /// this episode alone, as in the built-in world; the world gets its own.
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
