//! The world process: owns the run's clock and the car.

use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use process::{Arguments, Member, Pulse, SetUpError, Skipped, Tick, exit_code};
use rustix::time::{ClockId, Timespec};
use shm_config::config::{Late, Run};
use shm_config::message::{
    Command, Header, HealthState, Message, Observation, Outcome, Part, Progress,
};
use shm_config::services::{COMMAND, EPISODE, OBSERVATION, PROGRESS, Process};
use shm_config::time::monotonic;
use shm_config::wire::{Doorbell, Publisher, Subscriber};
use shm_config::{Instant, message::Episode};
use sim::grid::Grid;
use sim::photographer::{Move, Photographer, Recorder, Seen};
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
    /// Time that the run has driven already, ns; a restarted world goes on from there
    #[arg(long, default_value_t = 0)]
    driven_ns: u64,
}

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

/// What an instant of the world's grid is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Moment {
    /// The first of a tick of the run: the others are woken and answer.
    Tick,
    /// One between two ticks.
    Between,
}

struct Session {
    member: Member,
    ports: Ports,
    pulse: Pulse,
    world: World,
    recorder: Recorder,
    _photographer: Photographer,
    lockstep: bool,
    grid: Grid,
    score: Score,
    observation: Box<Observation>,
    command: Option<Command>,
    episode: u32,
    episode_skipped: u64,
    /// The run's newest tick that was published.
    told: Option<u64>,
    /// What worlds before this one have driven.
    driven_ns: u64,
    /// Instants missed just before this one: it was late by more than a period.
    missed: u64,
}

/// The first instant lies at least one period ahead: everybody can be there. All
/// worlds of a run, the restarted ones too, share the phase of their grid, so that
/// `elapsed / period` stays a whole number over restarts; runs side by side do not.
fn first_instant(run: &Run, now: Instant) -> Instant {
    let period_ns = run.period_ns();
    let mix = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
    let phase_ns = run.name.bytes().fold(0xcbf2_9ce4_8422_2325, mix) % period_ns;
    let least_ns = now.0 + period_ns;
    let passed_ns = (least_ns - phase_ns) % period_ns;
    Instant(least_ns + (period_ns - passed_ns) % period_ns)
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
        let own = |error: &dyn std::fmt::Display| SetUpError::Own(error.to_string());
        let mut world =
            World::new(WorldConfig::from(&member.config.world)).map_err(|error| own(&error))?;
        let episode = cli.first_episode;
        let seed = member.config.run.episode_seed(episode);
        world.reset(seed).map_err(|error| own(&error))?;
        let (photographer, mut recorder) = Photographer::start(&member.config)?;
        recorder.begin(episode, seed);
        member.claim_rights();
        pulse.set_rights(&member.rights);
        pulse.enter(HealthState::Ready, monotonic());
        let first = match member.config.run.is_lockstep() {
            true => Instant(0),
            false => first_instant(&member.config.run, monotonic()),
        };
        Ok(Self {
            grid: Grid::new(&member.config, first),
            lockstep: member.config.run.is_lockstep(),
            score: Score::new(seed),
            member,
            ports,
            pulse,
            world,
            recorder,
            _photographer: photographer,
            observation: Box::default(),
            command: None,
            episode,
            episode_skipped: 0,
            told: None,
            driven_ns: cli.driven_ns,
            missed: 0,
        })
    }

    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn drive(&mut self) -> Result<(), SetUpError> {
        self.pulse.health.first_scheduled_ns = self.grid.tick_instant(0).0;
        self.pulse.health.state = HealthState::Running.code();
        loop {
            self.sleep();
            let released = monotonic();
            self.pulse.begin(released);
            let now = match self.lockstep {
                true => self.grid.now(),
                false => released,
            };
            if !self.grid.is_first() && self.advance(now)? {
                self.record_missed(self.grid.previous(), self.missed, released);
                break;
            }
            self.pulse.end(Part::Move, monotonic());
            if self.is_late() && self.deadline() == Late::Skip {
                self.record_missed(self.grid.now(), self.missed + 1, released);
                self.grid.move_on();
                self.schedule();
                self.pulse.beat(monotonic());
                self.ports.tend();
                continue;
            }
            let moment = match self.told == Some(self.grid.tick()) {
                true => Moment::Between,
                false => Moment::Tick,
            };
            self.told = Some(self.grid.tick());
            self.publish(released, now, moment);
            self.account(released, moment);
            self.ports.tend();
            if self.lockstep && moment == Moment::Tick {
                self.await_command();
            }
        }
        self.schedule();
        self.pulse.enter(HealthState::Finished, monotonic());
        Ok(())
    }

    /// Sleeps until the next instant is due. Those that passed meanwhile are
    /// missed, and counted.
    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    fn sleep(&mut self) {
        if self.lockstep {
            return;
        }
        let timespec: Timespec = self.grid.now().timespec();
        while rustix::thread::clock_nanosleep_absolute(ClockId::Monotonic, &timespec).is_err() {}
        let missed = self.grid.missed();
        self.grid.miss_until(monotonic());
        self.missed = self.grid.missed() - missed;
    }

    fn is_late(&self) -> bool {
        self.missed > 0
    }

    /// So many instants, the newest of them that one, had no tick until one was
    /// begun then.
    fn record_missed(&mut self, newest: Instant, count: u64, begun: Instant) {
        let skipped = Skipped {
            newest,
            period_ns: self.grid.step_ns(),
            count,
        };
        self.pulse.record_skipped(skipped, begun);
    }

    fn deadline(&self) -> Late {
        self.member.config.deadlines.world
    }

    /// Ends the instant of now: counts it, and as a tick where the run has one.
    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn account(&mut self, released: Instant, moment: Moment) {
        let done = monotonic();
        self.pulse.end(Part::Send, done);
        self.pulse.record_tick(Tick {
            due: match self.lockstep {
                true => released,
                false => self.grid.now(),
            },
            // In lockstep a command releases it, not the timer.
            released: (!self.lockstep).then(|| self.grid.now()),
            begun: released,
            done,
        });
        self.record_missed(self.grid.previous(), self.missed, released);
        self.grid.move_on();
        self.pulse.health.ticks += u64::from(moment == Moment::Tick);
        self.schedule();
        self.pulse.beat(done);
    }

    /// Ticks and skipped ones are those of the run's grid; late is every instant
    /// of the world's own that was missed.
    fn schedule(&mut self) {
        let (due, skipped) = (self.grid.ticks_due(), self.skipped());
        let health = &mut self.pulse.health;
        health.header.tick = due.saturating_sub(1);
        health.skipped = skipped;
        health.next_scheduled_ns = self.grid.tick_instant(due).0;
        health.late = self.grid.missed();
    }

    fn skipped(&self) -> u64 {
        self.grid.ticks_due() - self.pulse.health.ticks
    }

    /// Obeys the newest command for the sub-steps that are due; `true` when the
    /// run is done.
    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    fn advance(&mut self, begun: Instant) -> Result<bool, SetUpError> {
        let newest = self.ports.commands.newest();
        // Read after the port: of a command that came meanwhile, an earlier instant
        // would say that it is from the future.
        let now = match self.lockstep {
            true => begun,
            false => monotonic(),
        };
        self.take(newest, now);
        let substeps = self.grid.take_substeps();
        if substeps == 0 {
            return Ok(self.ends(now));
        }
        let limit_ns = self.member.config.limits.command_age_ns();
        let young = self
            .command
            .filter(|command| command.admit(now, limit_ns).is_ok())
            .filter(|_| !(self.is_late() && self.deadline() == Late::Brake));
        let action = self.score.obey(young.as_ref(), now);
        self.recorder.moved(Move { action, substeps });
        for _ in 0..substeps {
            let Some(step) = self.world.substep(action) else {
                continue;
            };
            self.score.count(&step);
            if step.has_ended() {
                return self.begin_next(step.outcome, now);
            }
        }
        Ok(self.ends(now))
    }

    /// After the end of an episode: the next one; `true` when there is none.
    fn begin_next(&mut self, outcome: Outcome, now: Instant) -> Result<bool, SetUpError> {
        self.close_episode(outcome, now);
        let episodes = self.member.config.run.episodes;
        let was_last = episodes > 0 && self.episode + 1 >= episodes;
        if was_last || self.is_over(now) {
            return Ok(true);
        }
        self.open_episode()?;
        Ok(false)
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
        let elapsed_ns = self.driven_ns + now.since_ns(self.grid.tick_instant(0));
        let passed = duration_s > 0.0 && elapsed_ns as f64 >= duration_s * 1e9;
        passed || self.member.is_stopping()
    }

    /// Keeps the newest command that is for this episode and well formed.
    fn take(&mut self, newest: Option<Command>, now: Instant) {
        let Some(command) = newest else {
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
        episode.skipped = self.skipped() - self.episode_skipped;
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
        let seed = self.member.config.run.episode_seed(self.episode);
        self.world
            .reset(seed)
            .map_err(|error| SetUpError::Own(format!("seed {seed}: {error}")))?;
        self.recorder.begin(self.episode, seed);
        self.score = Score::new(seed);
        self.episode_skipped = self.skipped();
        self.command = None;
        Ok(())
    }

    fn header(&self, now: Instant) -> Header {
        Header {
            tick: self.grid.tick(),
            taken_ns: now.0,
            episode: self.episode,
            ..Header::default()
        }
    }

    /// Publishes what is seen. Between two ticks of the run nobody is woken by it.
    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    fn publish(&mut self, released: Instant, now: Instant, moment: Moment) {
        let passed = self.grid.substep_share();
        self.world.observe_between(passed, &mut self.observation);
        self.pulse.end(Part::Observe, monotonic());
        self.observation.header = self.header(now);
        self.observation.scheduled_ns = match self.lockstep {
            true => released.0,
            false => self.grid.tick_instant(self.grid.tick()).0,
        };
        self.observation.released_ns = released.0;
        self.recorder.saw(Seen {
            tick: self.grid.tick(),
            taken_ns: now.0,
            passed,
        });
        match moment {
            Moment::Tick => {
                self.observation.published_ns = monotonic().0;
                self.ports.observations.send(&mut self.observation);
                self.publish_progress(now, Outcome::Driving);
            }
            Moment::Between => {
                let port = &mut self.ports.observations;
                port.send_quietly(&mut self.observation);
            }
        }
    }

    fn publish_progress(&mut self, now: Instant, outcome: Outcome) {
        let mut progress = self.score.progress(&self.world, outcome);
        progress.header = self.header(now);
        progress.skipped = self.skipped();
        self.ports.progress.send(&mut progress);
    }

    /// In lockstep the next tick begins when the command for this one is there.
    /// Nobody is waited for endlessly: then the car brakes.
    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    fn await_command(&mut self) {
        let asked = self.told;
        let wait_ns = self.member.config.world_wait_ns();
        let until = monotonic().after_ns(wait_ns);
        loop {
            if let Some(command) = self.ports.commands.newest() {
                let answers = Some(command.header.tick) == asked
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worlds_of_a_run_share_the_phase_of_their_grid() {
        let mut run = Run::default();
        let period_ns = run.period_ns();
        let first = first_instant(&run, Instant(5_123_456_789));
        for passed_ns in [0, 1, period_ns / 3, period_ns, 7 * period_ns + 12_345] {
            let now = Instant(5_123_456_789 + passed_ns);
            let next = first_instant(&run, now);
            assert_eq!(next.since_ns(first) % period_ns, 0, "{passed_ns}");
            let ahead_ns = next.since_ns(now);
            assert!((period_ns..2 * period_ns).contains(&ahead_ns), "{ahead_ns}");
        }
        run.name = "another".into();
        let other = first_instant(&run, Instant(5_123_456_789));
        assert_ne!(other, first, "sets side by side do not tick at once");
    }
}
