//! The world process: owns the run's clock and the car.

use std::cmp::Ordering;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use runtime::{Arguments, Contest, Deadline, Member, Pulse, SetUpError, Skipped, Tick, exit_code};
use rustix::time::{ClockId, Timespec};
use shm_config::config::Late;
use shm_config::message::{
    Command, Header, HealthState, Message, Observation, Outcome, Part, Refusal,
};
use shm_config::services::{COMMAND, Process};
use shm_config::time::monotonic;
use shm_config::{Instant, RunGrid};
use sim::grid::Grid;
use sim::photographer::{Move, Photographer, Recorder, Seen};
use sim::ports::Ports;
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
    contest: Contest,
    episode: u32,
    episode_skipped: u64,
    /// The run's newest tick that was published.
    told: Option<u64>,
    /// What worlds before this one have driven.
    driven_ns: u64,
    /// Instants missed just before this one: it was late by more than a period.
    missed: u64,
}

/// The door for commands: also of the episode that is driven.
fn admit(command: &Command, now: Instant, limit_ns: u64, episode: u32) -> Result<(), Refusal> {
    command.admit(now, limit_ns)?;
    check_episode(command, episode)
}

/// The door for commands in lockstep, where time is counted in ticks: only the answer
/// to the tick that was asked about is in time.
fn admit_answer(
    command: &Command,
    asked: u64,
    period_ns: u64,
    episode: u32,
) -> Result<(), Refusal> {
    command.check()?;
    check_episode(command, episode)?;
    let tick = command.header.tick;
    let ticks_ns = |ticks: u64| ticks.saturating_mul(period_ns);
    match tick.cmp(&asked) {
        Ordering::Equal => Ok(()),
        Ordering::Less => Err(Refusal::Stale {
            age_ns: ticks_ns(asked - tick),
            limit_ns: 0,
        }),
        Ordering::Greater => Err(Refusal::Future {
            ahead_ns: ticks_ns(tick - asked),
        }),
    }
}

fn check_episode(command: &Command, episode: u32) -> Result<(), Refusal> {
    match command.header.episode == episode {
        true => Ok(()),
        false => Err(Refusal::Episode {
            episode: command.header.episode,
            expected: episode,
        }),
    }
}

fn run(cli: &Cli) -> Result<(), SetUpError> {
    let mut session = Session::open(cli)?;
    session.drive()
}

impl Session {
    #[allow(clippy::disallowed_methods)] // a process entry point reads the clock
    fn open(cli: &Cli) -> Result<Self, SetUpError> {
        let mut member = Member::join(Process::World, &cli.arguments)?;
        let ports = Ports::open(&member.wire)?;
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
            false => RunGrid::of(&member.config).first_instant(monotonic()),
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
            contest: Contest::default(),
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
                self.note_deadline(monotonic());
                self.grid.move_on();
                self.schedule();
                self.pulse.beat(monotonic());
                self.ports.update_connections();
                continue;
            }
            let moment = match self.told == Some(self.grid.tick()) {
                true => Moment::Between,
                false => Moment::Tick,
            };
            self.told = Some(self.grid.tick());
            self.publish(released, now, moment);
            self.account(released, moment);
            self.ports.update_connections();
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

    /// The instant of now is done, or skipped. In lockstep nothing can be late.
    fn note_deadline(&mut self, done: Instant) {
        if !self.lockstep {
            self.pulse.note_deadline(Deadline {
                tick: self.grid.tick(),
                deadline: self.grid.now().after_ns(self.grid.step_ns()),
                done,
                skipped: self.missed,
                period_ns: self.grid.step_ns(),
            });
        }
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
        self.note_deadline(done);
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
        // Read after the command came, which else would be from the future.
        let clock = || match self.lockstep {
            true => begun,
            false => monotonic(),
        };
        let limit_ns = self.member.config.age_limit_ns(COMMAND.row.age_limit);
        let episode = self.episode;
        let door = |command: &Command| admit(command, clock(), limit_ns, episode);
        self.ports.commands.newest_into(&mut self.command, door);
        let now = clock();
        let is_contested = self.contest.look(&self.member.wire, now);
        self.pulse.count_refused(&self.member.wire);
        let substeps = self.grid.take_substeps();
        if substeps == 0 {
            return Ok(self.ends(now));
        }
        let is_braked = is_contested || self.is_late() && self.deadline() == Late::Brake;
        let young = self
            .command
            .filter(|command| !is_braked && command.admit(now, limit_ns).is_ok());
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
        let asked = self.told.unwrap_or_default();
        let (episode, period_ns) = (self.episode, self.member.config.run.period_ns());
        let door = |command: &Command| admit_answer(command, asked, period_ns, episode);
        let wait_ns = self.member.config.world_wait_ns();
        let until = monotonic().after_ns(wait_ns);
        loop {
            if self.ports.commands.newest_into(&mut self.command, door) {
                return;
            }
            let now = monotonic();
            if now >= until || self.member.is_stopping() {
                return;
            }
            self.pulse.beat(now);
            self.ports.update_connections();
            let left = Duration::from_nanos(until.since_ns(now));
            self.ports.bell.wait(NAP.min(left));
        }
    }
}
