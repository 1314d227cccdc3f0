//! The world process: owns the run's clock, and decides which command moves the plant.

use clap::Args;
use runtime::{
    Contest, Deadline, FixedRate, Flow, Member, SetUpError, Tick, TickLoop, TickSchedule,
};
use shm_config::config::{Config, Late};
use shm_config::message::{Command, Header, HealthState, Message, Observation, Outcome, Part};
use shm_config::services::COMMAND;
use shm_config::{Instant, RunGrid};

use crate::door;
use crate::plant::{Moment, Plant};
use crate::ports::Ports;
use crate::robot::Reading;

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

/// Runs a plant as the world of a run until its episodes or its time are over, or it is
/// stopped.
///
/// # Errors
/// When shared memory refuses, or the plant cannot begin an episode.
pub fn run(member: Member, plant: impl Plant, begin: Begin) -> Result<(), SetUpError> {
    let ports = Ports::open(&member.wire)?;
    let mut process = WorldProcess::new(&member.config, (plant, ports), begin)?;
    TickLoop::start(member)?.run(&mut process)
}

/// The kind of an instant of the world's grid.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Place {
    /// The first instant of a tick of the run: the other processes are woken and
    /// answer.
    Tick,
    /// An instant between two ticks.
    Between,
}

/// A plant with the ports of a world.
pub struct WorldProcess<P> {
    ports: Ports,
    config: Config,
    plant: P,
    lockstep: bool,
    schedule: TickSchedule,
    observation: Box<Observation>,
    command: Option<Command>,
    contest: Contest,
    episode: u32,
    episode_skipped: u64,
    /// The run's newest tick that was published.
    published: Option<u64>,
    /// The counts of earlier worlds of this run.
    driven_ns: u64,
    /// Instants missed just before this one: it was late by more than a period.
    missed: u64,
}

impl<P: Plant> WorldProcess<P> {
    /// Begins the first episode.
    ///
    /// # Errors
    /// When the plant cannot begin it.
    pub fn new(
        config: &Config,
        (mut plant, ports): (P, Ports),
        begin: Begin,
    ) -> Result<Self, SetUpError> {
        let episode = begin.first_episode;
        begin_episode(&mut plant, config, episode)?;
        Ok(Self {
            ports,
            plant,
            lockstep: config.run.is_lockstep(),
            schedule: schedule(config, Instant(0)),
            config: config.clone(),
            observation: Box::default(),
            command: None,
            contest: Contest::default(),
            episode,
            episode_skipped: 0,
            published: None,
            driven_ns: begin.driven_ns,
            missed: 0,
        })
    }

    /// Records that the newest instant, and those missed before it, had no tick until
    /// the one begun at `begun`.
    fn record_missed(&self, run: &mut TickLoop, newest: Instant, count: u64, begun: Instant) {
        let skipped = runtime::Skipped {
            newest,
            period_ns: self.schedule.step_ns(),
            count,
        };
        run.telemetry.record_skipped(skipped, begun);
    }

    /// Notes whether the present instant was done in time.
    fn note_deadline(&self, run: &mut TickLoop, done: Instant) {
        run.telemetry.note_deadline(Deadline {
            tick: self.schedule.tick(),
            deadline: self.schedule.now().after_ns(self.schedule.step_ns()),
            done,
            skipped: self.missed,
            period_ns: self.schedule.step_ns(),
        });
    }

    /// Ends the present instant: counts it, and counts a tick where the run has one.
    fn account(&mut self, run: &mut TickLoop, released: Instant) {
        let done = run.now();
        run.telemetry.end(Part::Send, done);
        let due = self.schedule.now();
        run.telemetry.record_tick(Tick {
            due: if self.lockstep { released } else { due },
            // In lockstep a command releases the instant, not the timer.
            released: (!self.lockstep).then_some(due),
            begun: released,
            done,
        });
        self.record_missed(run, self.schedule.previous(), self.missed, released);
        self.note_deadline(run, done);
        self.schedule.move_on();
        self.report(run);
    }

    /// Ends the present instant without an observation: it counts as skipped.
    fn skip(&mut self, run: &mut TickLoop, released: Instant) {
        self.record_missed(run, self.schedule.now(), self.missed + 1, released);
        self.note_deadline(run, run.now());
        self.schedule.move_on();
        self.report(run);
    }

    /// Reports ticks and skipped ticks of the run's grid; `late` counts all instants of
    /// the world's own grid that were missed.
    fn report(&self, run: &mut TickLoop) {
        let health = &mut run.telemetry.health;
        self.schedule.report(health);
        health.header.tick = self.schedule.ticks_due().saturating_sub(1);
        health.late = self.schedule.missed();
    }

    /// Applies the newest command in the sub-steps that are due.
    fn advance(&mut self, run: &TickLoop, begun: Instant) -> Result<Flow, SetUpError> {
        // The clock is read after the command; otherwise the command would seem to come
        // from the future.
        let clock = || match self.lockstep {
            true => begun,
            false => run.now(),
        };
        let limit_ns = self.config.age_limit_ns(COMMAND.row.age_limit);
        let episode = self.episode;
        let door = |command: &Command| door::admit(command, clock(), limit_ns, episode);
        self.ports.commands.newest_into(&mut self.command, door);
        let now = clock();
        let is_contested = self.contest.look(&run.member.wire, now);
        let is_late = self.missed > 0 && self.config.deadlines.world == Late::Brake;
        let young = self
            .command
            .filter(|command| !is_contested && !is_late && command.admit(now, limit_ns).is_ok());
        match self.plant.advance(self.moment(now), young.as_ref()) {
            Some(outcome) => self.begin_next(run, outcome, now),
            None => Ok(self.end(run, now)),
        }
    }

    fn moment(&self, now: Instant) -> Moment {
        Moment {
            index: self.schedule.index(),
            tick: self.schedule.tick(),
            now,
            missed: self.missed,
        }
    }

    /// Begins the next episode after the end of one, if there is one.
    fn begin_next(
        &mut self,
        run: &TickLoop,
        outcome: Outcome,
        now: Instant,
    ) -> Result<Flow, SetUpError> {
        self.close_episode(outcome, now);
        let episodes = self.config.run.episodes;
        let was_last = episodes > 0 && self.episode + 1 >= episodes;
        if was_last || self.is_over(run, now) {
            return Ok(Flow::End);
        }
        self.open_episode()?;
        Ok(Flow::Continue)
    }

    /// Ends the run when it was stopped or its time is up.
    fn end(&mut self, run: &TickLoop, now: Instant) -> Flow {
        if !self.is_over(run, now) {
            return Flow::Continue;
        }
        self.close_episode(Outcome::Stopped, now);
        Flow::End
    }

    fn is_over(&self, run: &TickLoop, now: Instant) -> bool {
        let duration_s = self.config.run.duration_s;
        let elapsed_ns = self.driven_ns + self.schedule.elapsed_ns(now);
        let passed = duration_s > 0.0 && elapsed_ns as f64 >= duration_s * 1e9;
        passed || run.member.is_stopping()
    }

    fn close_episode(&mut self, outcome: Outcome, now: Instant) {
        let mut episode = self.plant.episode(outcome);
        episode.header = self.header(now);
        episode.skipped = self.schedule.skipped() - self.episode_skipped;
        self.ports.episodes.send(&mut episode);
        tracing::info!(
            seed = episode.seed,
            %outcome,
            ticks = episode.ticks,
            completion = episode.completion,
            contacts = episode.contacts(),
            braked = episode.braked,
            "episode"
        );
        self.publish_progress(now, outcome);
    }

    fn open_episode(&mut self) -> Result<(), SetUpError> {
        self.episode += 1;
        begin_episode(&mut self.plant, &self.config, self.episode)?;
        self.episode_skipped = self.schedule.skipped();
        self.command = None;
        Ok(())
    }

    fn header(&self, now: Instant) -> Header {
        Header {
            tick: self.schedule.tick(),
            taken_ns: now.0,
            episode: self.episode,
            ..Header::default()
        }
    }

    /// Publishes the observation, if there is one. Between two ticks of the run it wakes
    /// no reader.
    fn publish(
        &mut self,
        run: &mut TickLoop,
        released: Instant,
        now: Instant,
        place: Place,
    ) -> Reading {
        let moment = self.moment(now);
        if self.plant.observe(moment, &mut self.observation) == Reading::Lost {
            return Reading::Lost;
        }
        run.telemetry.end(Part::Observe, run.member.now());
        self.observation.header = self.header(now);
        self.observation.scheduled_ns = match self.lockstep {
            true => released.0,
            false => self.schedule.scheduled().0,
        };
        self.observation.released_ns = released.0;
        match place {
            Place::Tick => {
                self.observation.published_ns = run.now().0;
                self.ports.observations.send(&mut self.observation);
                self.publish_progress(now, Outcome::Driving);
                self.schedule.begin();
            }
            Place::Between => {
                let port = &mut self.ports.observations;
                port.send_quietly(&mut self.observation);
            }
        }
        Reading::Fresh
    }

    fn publish_progress(&mut self, now: Instant, outcome: Outcome) {
        let mut progress = self.plant.progress(outcome);
        progress.header = self.header(now);
        progress.skipped = self.schedule.skipped();
        self.ports.progress.send(&mut progress);
    }

    /// In lockstep the next tick begins when the command for the last one has arrived.
    /// The wait has a limit; after it the car brakes.
    fn await_command(&mut self, run: &mut TickLoop) {
        // Only a tick that was just published gets an answer.
        let asked = match self.published {
            Some(tick) if self.schedule.index() == tick * self.config.world_instants() + 1 => tick,
            _ => return,
        };
        let (episode, period_ns) = (self.episode, self.config.run.period_ns());
        let door = |command: &Command| door::admit_answer(command, asked, period_ns, episode);
        let until = run.now().after_ns(self.config.world_wait_ns());
        loop {
            if self.ports.commands.newest_into(&mut self.command, door) {
                return;
            }
            let now = run.now();
            if now >= until || run.member.is_stopping() {
                return;
            }
            self.update_connections();
            run.wait_alive(until, now);
        }
    }
}

fn begin_episode(plant: &mut impl Plant, config: &Config, episode: u32) -> Result<(), SetUpError> {
    let seed = config.run.episode_seed(episode);
    plant
        .begin(episode, seed)
        .map_err(|error| SetUpError::Own(format!("seed {seed}: {error}")))
}

/// The world's grid with this first instant.
fn schedule(config: &Config, first: Instant) -> TickSchedule {
    TickSchedule::on_timer(config.run.period_ns(), config.world_instants(), first)
}

impl<P: Plant> FixedRate for WorldProcess<P> {
    /// The instant at which the tick was released.
    type Due = Instant;

    fn ready(&mut self, run: &mut TickLoop) {
        if !self.lockstep {
            let first = RunGrid::of(&self.config).first_instant(run.now());
            self.schedule = schedule(&self.config, first);
        }
        self.schedule.report(&mut run.telemetry.health);
        run.telemetry.health.state = HealthState::Running.code();
    }

    fn update_connections(&mut self) {
        self.ports.update_connections();
    }

    /// The next tick then closes the episode.
    fn stop(&mut self, _run: &mut TickLoop, _now: Instant) -> Flow {
        Flow::Continue
    }

    /// Sleeps until the next instant is due. Instants that passed before the wake-up
    /// count as missed.
    fn await_tick(&mut self, run: &mut TickLoop) -> Option<Instant> {
        if self.lockstep {
            self.await_command(run);
        } else {
            run.sleep_until(self.schedule.now());
            self.missed = self.schedule.miss_until(run.now());
        }
        Some(run.now())
    }

    fn tick(&mut self, run: &mut TickLoop, released: Instant) -> Result<Flow, SetUpError> {
        run.telemetry.begin(released);
        let now = match self.lockstep {
            true => self.schedule.now(),
            false => released,
        };
        let is_first = self.schedule.index() == 0;
        if !is_first && self.advance(run, now)? == Flow::End {
            self.record_missed(run, self.schedule.previous(), self.missed, released);
            return Ok(Flow::End);
        }
        run.telemetry.end(Part::Move, run.member.now());
        if self.missed > 0 && self.config.deadlines.world == Late::Skip {
            self.skip(run, released);
            return Ok(Flow::Continue);
        }
        let place = match self.published == Some(self.schedule.tick()) {
            true => Place::Between,
            false => Place::Tick,
        };
        match self.publish(run, released, now, place) {
            Reading::Fresh => {
                self.published = Some(self.schedule.tick());
                self.account(run, released);
            }
            Reading::Lost => self.skip(run, released),
        }
        Ok(Flow::Continue)
    }

    fn finish(&mut self, run: &mut TickLoop) {
        self.report(run);
    }
}
