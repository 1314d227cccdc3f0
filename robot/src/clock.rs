//! The run's clock, which its world owns.

use clap::Args;
use runtime::{Contest, Deadline, Skipped, Tick, TickLoop, TickSchedule};
use shm_config::config::{Config, Late};
use shm_config::message::{Command, Header, HealthState, Message, Observation, Part};
use shm_config::services::COMMAND;
use shm_config::{Instant, RunGrid};

use crate::door;
use crate::plant::Moment;
use crate::ports::Ports;

/// Where a world of a run begins.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct Begin {
    /// Episode of the run to begin with; its seed is the run's plus this
    #[arg(long, default_value_t = 0)]
    pub first_episode: u32,
    /// Time that the run has driven already, ns; a restarted world goes on from there
    #[arg(long, default_value_t = 0)]
    pub driven_ns: u64,
}

/// What each world does at an instant: it waits for it, decides which command may be
/// obeyed, sends the observation with its instants, and reports.
///
/// In this order: [`WorldClock::start`]; then for each instant
/// [`WorldClock::await_instant`] until it is true, [`WorldClock::command`], and either
/// [`WorldClock::date`], [`WorldClock::publish`] and [`WorldClock::end_instant`], or
/// [`WorldClock::skip_instant`].
pub struct WorldClock {
    config: Config,
    is_lockstep: bool,
    schedule: TickSchedule,
    command: Option<Command>,
    contest: Contest,
    episode: u32,
    /// Ticks that were skipped before this episode.
    skipped_before: u64,
    /// The run's newest tick that was published, and when.
    published: Option<(u64, Instant)>,
    /// Time that earlier worlds of this run have driven, ns.
    driven_ns: u64,
    /// Instants missed just before this one: it was late by more than a period.
    missed: u64,
    /// In lockstep, when the present wait for a command is over.
    until: Option<Instant>,
    /// When the world was woken for the present instant, on the machine's clock.
    released: Instant,
    /// The present instant on the run's clock.
    now: Instant,
}

impl WorldClock {
    /// A clock before its first instant.
    pub fn new(config: &Config, begin: Begin) -> Self {
        Self {
            config: config.clone(),
            is_lockstep: config.run.is_lockstep(),
            schedule: schedule(config, Instant(0)),
            command: None,
            contest: Contest::default(),
            episode: begin.first_episode,
            skipped_before: 0,
            published: None,
            driven_ns: begin.driven_ns,
            missed: 0,
            until: None,
            released: Instant(0),
            now: Instant(0),
        }
    }

    /// The episode of the run.
    pub fn episode(&self) -> u32 {
        self.episode
    }

    /// The seed of the episode.
    pub fn seed(&self) -> u64 {
        self.config.run.episode_seed(self.episode)
    }

    /// The tick of the run.
    pub fn tick(&self) -> u64 {
        self.schedule.tick()
    }

    /// The present instant.
    pub fn moment(&self) -> Moment {
        Moment {
            index: self.schedule.index(),
            tick: self.schedule.tick(),
            now: self.now,
            missed: self.missed,
        }
    }

    /// When the world was woken for the present instant, on the machine's clock.
    pub fn released(&self) -> Instant {
        self.released
    }

    /// When the present instant was due, on the machine's clock; in lockstep, when the
    /// world was woken for it.
    pub fn scheduled(&self) -> Instant {
        match self.is_lockstep {
            true => self.released,
            false => self.schedule.scheduled(),
        }
    }

    /// Time from instant to instant, ns.
    pub fn step_ns(&self) -> u64 {
        self.schedule.step_ns()
    }

    /// Ticks skipped so far, and those of them in this episode.
    pub fn skipped(&self) -> (u64, u64) {
        let skipped = self.schedule.skipped();
        (skipped, skipped - self.skipped_before)
    }

    /// The header of what this instant publishes.
    pub fn header(&self) -> Header {
        Header {
            tick: self.schedule.tick(),
            taken_ns: self.now.0,
            episode: self.episode,
            ..Header::default()
        }
    }

    /// Everything is connected: the first instant is the next one of the run's grid.
    pub fn start(&mut self, run: &mut TickLoop) {
        if !self.is_lockstep {
            let first = RunGrid::of(&self.config).first_instant(run.now());
            self.schedule = schedule(&self.config, first);
        }
        self.schedule.report(&mut run.telemetry.health);
        run.telemetry.health.state = HealthState::Running.code();
    }

    /// Sleeps until the next instant is due; those that passed meanwhile count as
    /// missed. In lockstep it is due when the command for the last tick has arrived; while
    /// it has not, this waits once, no longer than the interval of heartbeats, and returns
    /// false.
    pub fn await_instant(&mut self, run: &TickLoop, ports: &mut Ports) -> bool {
        if !self.is_lockstep {
            run.sleep_until(self.schedule.now());
            self.missed = self.schedule.miss_until(run.now());
        } else if !self.has_answer(run, ports) {
            return false;
        }
        self.released = run.now();
        self.now = match self.is_lockstep {
            true => self.schedule.now(),
            false => self.released,
        };
        true
    }

    /// Whether the command for the last tick is there, or is not waited for any longer:
    /// then the car brakes.
    fn has_answer(&mut self, run: &TickLoop, ports: &mut Ports) -> bool {
        // Only a tick that was just published gets an answer.
        let instants = self.config.world_instants();
        let asked = match self.published {
            Some((tick, _)) if self.schedule.index() == tick * instants + 1 => tick,
            _ => return true,
        };
        let (episode, period_ns) = (self.episode, self.config.run.period_ns());
        let door = |command: &Command| door::admit_answer(command, asked, period_ns, episode);
        let now = run.now();
        let wait_ns = self.config.world_wait_ns();
        let until = *self.until.get_or_insert(now.after_ns(wait_ns));
        let newest = ports.commands.newest(door);
        let has_come = newest.is_some();
        self.command = newest.or(self.command);
        if !has_come && now < until && !run.member.is_stopping() {
            run.wait(Some(until), now);
            return false;
        }
        if !has_come {
            self.command = None;
        }
        self.until = None;
        true
    }

    /// The newest command if it may be obeyed at this instant, and the moment at which
    /// that was decided. Without a command the car brakes.
    pub fn command(&mut self, run: &TickLoop, ports: &mut Ports) -> (Moment, Option<Command>) {
        // The clock is read after the command; otherwise the command would seem to come
        // from the future.
        let (stands, present) = (self.is_lockstep, self.now);
        let clock = || match stands {
            true => present,
            false => run.now(),
        };
        let limit_ns = self.config.age_limit_ns(COMMAND.row.age_limit);
        let episode = self.episode;
        let door = |command: &Command| door::admit(command, clock(), limit_ns, episode);
        self.command = ports.commands.newest(door).or(self.command);
        let now = clock();
        let is_contested = self.contest.look(&run.member.wire, now);
        let is_late = self.missed > 0 && self.config.deadlines.world == Late::Brake;
        let young = |command: &Command| command.admit(now, limit_ns).is_ok();
        let command = self
            .command
            .filter(|command| !is_contested && !is_late && young(command));
        let moment = Moment {
            now,
            ..self.moment()
        };
        (moment, command)
    }

    /// Whether the run ends after this instant: it was stopped, or its time is up.
    pub fn is_over(&self, run: &TickLoop) -> bool {
        let duration_s = self.config.run.duration_s;
        let elapsed_ns = self.driven_ns + self.schedule.elapsed_ns(self.now);
        let has_passed = duration_s > 0.0 && elapsed_ns as f64 >= duration_s * 1e9;
        has_passed || run.member.is_stopping()
    }

    /// Whether no episode of the run follows this one.
    pub fn is_last_episode(&self) -> bool {
        let episodes = self.config.run.episodes;
        episodes > 0 && self.episode + 1 >= episodes
    }

    /// The next episode of the run begins; no command of the last one is obeyed in it.
    pub fn begin_next_episode(&mut self) {
        self.episode += 1;
        self.skipped_before = self.schedule.skipped();
        self.command = None;
    }

    /// Whether a late instant only moves the car.
    pub fn is_to_skip(&self) -> bool {
        self.missed > 0 && self.config.deadlines.world == Late::Skip
    }

    /// Fills in the header of this instant's observation, and when it was due.
    pub fn date(&self, observation: &mut Observation) {
        observation.header = self.header();
        observation.scheduled_ns = self.scheduled().0;
        observation.released_ns = self.released.0;
    }

    /// Sends the dated observation of this instant; returns whether it was sent. At the first
    /// instant of a tick it wakes its readers, and `tell` sends what else belongs to the
    /// tick; between two ticks it wakes none, and says when the tick was published.
    pub fn publish(
        &mut self,
        run: &TickLoop,
        ports: &mut Ports,
        observation: &mut Observation,
        tell: impl FnOnce(&Self, &mut Ports),
    ) -> bool {
        let tick = self.schedule.tick();
        if let Some((published, at)) = self.published
            && published == tick
        {
            observation.published_ns = at.0;
            return ports.observations.send_quietly(observation);
        }
        let now = run.now();
        self.published = Some((tick, now));
        observation.published_ns = now.0;
        let is_sent = ports.observations.send(observation);
        tell(self, ports);
        self.schedule.begin();
        is_sent
    }

    /// Ends the present instant: counts it, and counts a tick where the run has one.
    pub fn end_instant(&mut self, run: &mut TickLoop) {
        let done = run.now();
        run.telemetry.end(Part::Send, done);
        let due = self.schedule.now();
        run.telemetry.record_tick(Tick {
            due: if self.is_lockstep { self.released } else { due },
            // In lockstep a command releases the instant, not the timer.
            released: (!self.is_lockstep).then_some(due),
            begun: self.released,
            done,
        });
        self.record_missed(run);
        self.move_on(run, done);
    }

    /// Ends the present instant without an observation: it counts as skipped.
    pub fn skip_instant(&mut self, run: &mut TickLoop) {
        self.record_skipped(run, self.schedule.now(), self.missed + 1);
        self.move_on(run, run.now());
    }

    /// Records the instants missed just before this one. They had no tick until it began.
    pub fn record_missed(&self, run: &mut TickLoop) {
        self.record_skipped(run, self.schedule.previous(), self.missed);
    }

    fn record_skipped(&self, run: &mut TickLoop, newest: Instant, count: u64) {
        let skipped = Skipped {
            newest,
            period_ns: self.schedule.step_ns(),
            count,
        };
        run.telemetry.record_skipped(skipped, self.released);
    }

    fn move_on(&mut self, run: &mut TickLoop, done: Instant) {
        let period_ns = self.schedule.step_ns();
        run.telemetry.note_deadline(Deadline {
            tick: self.schedule.tick(),
            deadline: self.schedule.now().after_ns(period_ns),
            done,
            skipped: self.missed,
            period_ns,
        });
        self.schedule.move_on();
        self.report(run);
    }

    /// Reports ticks and skipped ticks of the run's grid; `late` counts all instants of
    /// the world's own grid that were missed.
    pub fn report(&self, run: &mut TickLoop) {
        let health = &mut run.telemetry.health;
        self.schedule.report(health);
        health.header.tick = self.schedule.ticks_due().saturating_sub(1);
        health.late = self.schedule.missed();
    }
}

/// The world's grid with this first instant.
fn schedule(config: &Config, first: Instant) -> TickSchedule {
    TickSchedule::on_timer(config.run.period_ns(), config.world_instants(), first)
}
