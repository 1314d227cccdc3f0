//! The world process: owns the run's clock and the car.

use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use process::{Arguments, Member, Pulse, SetUpError, exit_code};
use rustix::time::{ClockId, Timespec};
use shm_config::config::Config;
use shm_config::message::{Command, Header, HealthState, Message, Observation, Outcome, Progress};
use shm_config::services::{COMMAND, EPISODE, OBSERVATION, PROGRESS, Process};
use shm_config::time::monotonic;
use shm_config::wire::{Doorbell, Publisher, Subscriber};
use shm_config::{Instant, message::Episode};
use sim::{World, WorldConfig, score::Score};

/// Drives the built-in world: maps, traffic and rules of MetaDrive
#[derive(Parser)]
#[command(name = "vlaps-world", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
    /// Episode of the run to begin with; its seed is the run's plus this
    #[arg(long, default_value_t = 0)]
    first_episode: u32,
}

/// Ticks of the car's physics in a second: fixed by the simulator it mirrors.
/// At a higher rate the state is held in between.
const PHYSICS_HZ: f64 = 10.0;
/// How long the world sleeps at most before it says how it does.
const NAP: Duration = Duration::from_millis(20);

fn main() -> ExitCode {
    let cli = Cli::parse();
    exit_code(Process::World, run(&cli))
}

struct Ports {
    bell: Doorbell,
    commands: Subscriber<Command>,
    observations: Publisher<Observation>,
    progress: Publisher<Progress>,
    episodes: Publisher<Episode>,
}

impl Ports {
    fn open(member: &Member) -> Result<Self, SetUpError> {
        let wire = &member.wire;
        Ok(Self {
            bell: wire.doorbell(Process::World)?,
            commands: wire.subscriber(COMMAND)?,
            observations: wire.publisher(OBSERVATION)?,
            progress: wire.publisher(PROGRESS)?,
            episodes: wire.publisher(EPISODE)?,
        })
    }

    /// Connects to peers that came or came back, between ticks.
    fn tend(&mut self) {
        self.commands.tend();
        self.observations.tend();
        self.progress.tend();
        self.episodes.tend();
    }
}

/// The instants at which the world ticks.
struct Grid {
    lockstep: bool,
    period_ns: u64,
    first: Instant,
    tick: u64,
    skipped: u64,
}

impl Grid {
    fn new(config: &Config, first: Instant) -> Self {
        let lockstep = config.run.is_lockstep();
        Self {
            lockstep,
            period_ns: config.run.period_ns(),
            first: if lockstep { Instant(0) } else { first },
            tick: 0,
            skipped: 0,
        }
    }

    /// When a tick is due, on the run's clock.
    fn instant(&self, tick: u64) -> Instant {
        self.first.after_ns(tick * self.period_ns)
    }

    /// Sleeps until the next tick is due. Instants that passed meanwhile are
    /// skipped, and counted.
    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    fn sleep(&mut self) {
        if self.lockstep {
            return;
        }
        let due = self.instant(self.tick);
        let timespec: Timespec = due.timespec();
        while rustix::thread::clock_nanosleep_absolute(ClockId::Monotonic, &timespec).is_err() {}
        let late_ns = monotonic().since_ns(due);
        let passed = late_ns / self.period_ns;
        self.tick += passed;
        self.skipped += passed;
    }
}

struct Session {
    member: Member,
    ports: Ports,
    pulse: Pulse,
    world: World,
    grid: Grid,
    score: Score,
    observation: Box<Observation>,
    command: Option<Command>,
    /// Grid ticks to one tick of the physics.
    hold: u64,
    episode: u32,
    episode_skipped: u64,
    /// Ticks of the physics from the start of the run.
    stepped: u64,
}

fn run(cli: &Cli) -> Result<(), SetUpError> {
    let mut session = Session::open(cli)?;
    session.drive()
}

impl Session {
    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn open(cli: &Cli) -> Result<Self, SetUpError> {
        let mut member = Member::join(Process::World, &cli.arguments)?;
        let ports = Ports::open(&member)?;
        let mut pulse = Pulse::start(&member)?;
        let hold = (member.config.run.rate_hz / PHYSICS_HZ).round();
        let own = |error: &dyn std::fmt::Display| SetUpError::Own(error.to_string());
        let mut world =
            World::new(WorldConfig::from(&member.config.world)).map_err(|error| own(&error))?;
        let episode = cli.first_episode;
        let seed = member.config.run.seed.wrapping_add(u64::from(episode));
        world.reset(seed).map_err(|error| own(&error))?;
        member.claim_rights();
        pulse.set_rights(&member.rights);
        pulse.enter(HealthState::Ready, monotonic());
        // The first instant lies one period ahead: everybody can be there.
        let first = monotonic().after_ns(member.config.run.period_ns());
        Ok(Self {
            grid: Grid::new(&member.config, first),
            score: Score::new(seed),
            member,
            ports,
            pulse,
            world,
            observation: Box::default(),
            command: None,
            hold: hold as u64,
            episode,
            episode_skipped: 0,
            stepped: 0,
        })
    }

    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn drive(&mut self) -> Result<(), SetUpError> {
        self.pulse.health.first_scheduled_ns = self.grid.instant(0).0;
        self.pulse.health.state = HealthState::Running.code();
        loop {
            self.grid.sleep();
            let released = monotonic();
            let now = match self.grid.lockstep {
                true => self.grid.instant(self.grid.tick),
                false => released,
            };
            if self.grid.tick > 0 && self.advance(now)? {
                break;
            }
            self.publish(released, now);
            let done = monotonic();
            let scheduled = self.grid.instant(self.grid.tick);
            let lateness_ns = match self.grid.lockstep {
                true => 0,
                false => released.since_ns(scheduled),
            };
            self.grid.tick += 1;
            self.pulse.count_tick(lateness_ns, done.since_ns(released));
            self.account();
            self.pulse.beat(done);
            self.ports.tend();
            if self.grid.lockstep {
                self.await_command();
            }
        }
        self.account();
        self.pulse.enter(HealthState::Finished, monotonic());
        Ok(())
    }

    fn account(&mut self) {
        let health = &mut self.pulse.health;
        health.header.tick = self.grid.tick.saturating_sub(1);
        health.skipped = self.grid.skipped;
        health.next_scheduled_ns = self.grid.instant(self.grid.tick).0;
        health.late = health.skipped;
    }

    /// Obeys the newest command for one tick of the physics; `true` when the run
    /// is done.
    fn advance(&mut self, now: Instant) -> Result<bool, SetUpError> {
        self.take_command(now);
        let due = self.grid.tick / self.hold;
        if due == self.stepped {
            return Ok(self.ends(now));
        }
        self.stepped = due;
        let limit_ns = self.member.config.limits.command_age_ns();
        let young = self
            .command
            .filter(|command| command.admit(now, limit_ns).is_ok());
        let action = self.score.obey(young.as_ref(), now);
        let outcome = self.world.step(action);
        self.score.count(&outcome);
        if outcome.has_ended() {
            self.close_episode(outcome.outcome, now);
            let episodes = self.member.config.run.episodes;
            if episodes > 0 && self.episode + 1 >= episodes {
                return Ok(true);
            }
            if self.is_over(now) {
                return Ok(true);
            }
            self.open_episode()?;
            return Ok(false);
        }
        Ok(self.ends(now))
    }

    /// Somebody asked the world to stop, or the time is up.
    fn ends(&mut self, now: Instant) -> bool {
        let over = self.is_over(now);
        if over {
            self.close_episode(Outcome::Stopped, now);
        }
        over
    }

    fn is_over(&self, now: Instant) -> bool {
        let duration_s = self.member.config.run.duration_s;
        let elapsed_ns = now.since_ns(self.grid.instant(0));
        let passed = duration_s > 0.0 && elapsed_ns as f64 >= duration_s * 1e9;
        passed || self.member.is_stopping()
    }

    /// Keeps the newest command that is for this episode and well formed.
    fn take_command(&mut self, now: Instant) {
        let Some(command) = self.ports.commands.newest() else {
            return;
        };
        let limit_ns = self.member.config.limits.command_age_ns();
        match command.admit(now, limit_ns) {
            Ok(()) if command.header.episode == self.episode => self.command = Some(command),
            Ok(()) => {}
            Err(_) => self.pulse.health.refused += 1,
        }
    }

    fn close_episode(&mut self, outcome: Outcome, now: Instant) {
        let mut episode = self.score.episode(&self.world, outcome);
        episode.header = self.header(now);
        episode.skipped = self.grid.skipped - self.episode_skipped;
        self.ports.episodes.send(&mut episode);
        tracing::info!(
            seed = episode.seed,
            %outcome,
            ticks = episode.ticks,
            completion = episode.completion,
            contacts = episode.vehicle_contacts + episode.object_contacts,
            braked = episode.braked,
            "episode"
        );
        self.publish_progress(now, outcome);
    }

    fn open_episode(&mut self) -> Result<(), SetUpError> {
        self.episode += 1;
        let seed = self
            .member
            .config
            .run
            .seed
            .wrapping_add(u64::from(self.episode));
        self.world
            .reset(seed)
            .map_err(|error| SetUpError::Own(format!("seed {seed}: {error}")))?;
        self.score = Score::new(seed);
        self.episode_skipped = self.grid.skipped;
        self.command = None;
        Ok(())
    }

    fn header(&self, now: Instant) -> Header {
        Header {
            tick: self.grid.tick,
            taken_ns: now.0,
            episode: self.episode,
            ..Header::default()
        }
    }

    fn publish(&mut self, released: Instant, now: Instant) {
        self.world.observe(&mut self.observation);
        self.observation.header = self.header(now);
        self.observation.scheduled_ns = match self.grid.lockstep {
            true => released.0,
            false => self.grid.instant(self.grid.tick).0,
        };
        self.observation.released_ns = released.0;
        self.ports.observations.send(&mut self.observation);
        self.publish_progress(now, Outcome::Driving);
    }

    fn publish_progress(&mut self, now: Instant, outcome: Outcome) {
        let mut progress = self.score.progress(&self.world, outcome);
        progress.header = self.header(now);
        progress.skipped = self.grid.skipped;
        self.ports.progress.send(&mut progress);
    }

    /// In lockstep the next tick begins when the command for this one is there.
    /// Nobody is waited for endlessly: then the car brakes.
    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    fn await_command(&mut self) {
        let asked = self.grid.tick - 1;
        let wait_ns = (self.member.config.limits.lockstep_wait_s * 1e9) as u64;
        let until = monotonic().after_ns(wait_ns);
        loop {
            if let Some(command) = self.ports.commands.newest() {
                let answers = command.header.tick == asked
                    && command.header.episode == self.episode
                    && command.check().is_ok();
                if answers {
                    self.command = Some(command);
                    return;
                }
                self.pulse.health.refused += u64::from(command.check().is_err());
            }
            let now = monotonic();
            if now >= until || self.member.is_stopping() {
                return;
            }
            self.pulse.beat(now);
            self.ports.tend();
            let left = Duration::from_nanos(until.since_ns(now));
            self.ports.bell.wait(NAP.min(left));
        }
    }
}
