//! The world's side of a run: the grid, the age limit of commands, the brake and the
//! account of the episodes, as those of the built-in world (`sim/src/process/mod.rs`).

use runtime::{Contest, Deadline, Member, Skipped, TickLoop, TickSchedule};
use shm_config::config::{Config, Late};
use shm_config::message::{
    Command, Episode, Header, HealthState, Message, Observation, Outcome, Part, Progress,
};
use shm_config::services::{COMMAND, EPISODE, OBSERVATION, PROGRESS};
use shm_config::{Instant, RunGrid};
use vehicle::Action;

use crate::account::Account;
use crate::door::{Door, Enter};
use crate::failure::{Answer, Failure};
use crate::port::no_space;

shm_config::message! {
    /// One instant of the world.
    #[derive(Default)]
    pub struct Tick: 88 bytes {
        /// The tick of the run.
        pub tick: u64,
        /// Seed of the episode.
        pub seed: u64,
        /// When the instant was due, ns on the machine's clock.
        pub scheduled_ns: u64,
        /// When the world was woken for it, ns on the machine's clock.
        pub released_ns: u64,
        /// The instant, ns on the run's clock.
        pub taken_ns: u64,
        /// Instants missed just before this one.
        pub missed: u64,
        /// Time to move by, s: since the last instant, missed ones included; 0 when an
        /// episode begins.
        pub step_s: f64,
        /// The steering to obey, normalised, positive left.
        pub steer: f64,
        /// The pedal to obey, normalised, negative brakes.
        pub pedal: f64,
        /// The episode of the run, from 0.
        pub episode: u32,
        /// 1 when an episode begins: put the car at the start of the episode `seed`.
        pub begins: u32,
        /// 1 when no command was young enough, so that the action is the brake.
        pub braked: u32,
        /// Not used.
        pub reserved: u32,
    }
}

shm_config::ports! {
    /// What a world reads and publishes.
    pub struct Ports of World {
        /// The actions for the car.
        commands: read COMMAND: Command,
        /// What the car perceives.
        observations: write OBSERVATION: Observation,
        /// How far it is.
        progress: write PROGRESS: Progress,
        /// The episodes that ended.
        episodes: write EPISODE: Episode,
    }
}

/// The services that the loop publishes.
pub const PUBLISHED: &[&str] = &[OBSERVATION.name, PROGRESS.name, EPISODE.name];

/// What the world has to do next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Next {
    /// Await an instant.
    Await,
    /// Answer the instant.
    Finish,
    /// Exit: the run is over.
    Exit,
}

/// A world between its ports.
pub struct WorldSide {
    ports: Ports,
    config: Config,
    is_lockstep: bool,
    schedule: TickSchedule,
    has_begun: bool,
    next: Next,
    account: Account,
    command: Option<Command>,
    contest: Contest,
    episode: u32,
    episode_skipped: u64,
    /// The run's newest tick that was published, and when.
    published: Option<(u64, Instant)>,
    driven_ns: u64,
    missed: u64,
    /// An episode begins at the present instant.
    begins: bool,
    /// Instants that had passed when the world moved last.
    moved: u64,
    released: Instant,
    now: Instant,
}

impl WorldSide {
    /// Opens its ports. A restarted world begins at `episode`, after `driven_ns`.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub fn open(member: &Member, (episode, driven_ns): (u32, u64)) -> Result<Self, Failure> {
        let config = member.config.clone();
        Ok(Self {
            ports: Ports::open(&member.wire)?,
            is_lockstep: config.run.is_lockstep(),
            schedule: schedule(&config, Instant(0)),
            has_begun: false,
            next: Next::Await,
            account: Account::new(config.run.episode_seed(episode)),
            command: None,
            contest: Contest::default(),
            episode,
            episode_skipped: 0,
            published: None,
            driven_ns,
            missed: 0,
            begins: true,
            moved: 0,
            released: Instant(0),
            now: Instant(0),
            config,
        })
    }

    /// Waits for the next instant and takes the newest command. `None` when the run is
    /// over: the last episode is published, and the world exits with 0.
    ///
    /// # Errors
    /// When the instant before was not answered, or the last episode cannot be sent.
    pub fn await_tick(
        &mut self,
        run: &mut TickLoop,
        door: &mut Door,
    ) -> Result<Option<Tick>, Failure> {
        match self.next {
            Next::Await => {}
            Next::Exit => return Ok(None),
            Next::Finish => {
                let text = "vlaps_finish_tick has to answer the last tick first";
                return Err(Failure::invalid(text));
            }
        }
        self.ports.update_connections();
        let continues = self.has_begun && self.begins;
        if !self.has_begun {
            self.begin(run);
        }
        if !continues {
            self.await_instant(run);
        }
        let action = match self.begins {
            true => None,
            false => Some(self.action(run, door)),
        };
        if !self.begins && self.is_over(run) {
            let closed = self.close_episode(Outcome::Stopped);
            self.report(run);
            self.next = Next::Exit;
            return closed.map(|()| None);
        }
        self.next = Next::Finish;
        Ok(Some(self.tick(action)))
    }

    fn begin(&mut self, run: &mut TickLoop) {
        self.has_begun = true;
        if !self.is_lockstep {
            let first = RunGrid::of(&self.config).first_instant(run.now());
            self.schedule = schedule(&self.config, first);
        }
        self.schedule.report(&mut run.telemetry.health);
        run.telemetry.health.state = HealthState::Running.code();
    }

    /// In real time sleeps until the instant; those that passed meanwhile are missed. In
    /// lockstep it begins when the command for the last tick has arrived.
    fn await_instant(&mut self, run: &mut TickLoop) {
        if self.is_lockstep {
            self.await_command(run);
        } else {
            run.sleep_until(self.schedule.now());
            self.missed = self.schedule.miss_until(run.now());
        }
        self.released = run.now();
        run.telemetry.begin(self.released);
        self.now = match self.is_lockstep {
            true => self.schedule.now(),
            false => self.released,
        };
    }

    /// The wait has a limit; after it the car brakes.
    fn await_command(&mut self, run: &mut TickLoop) {
        // Only a tick that was just published gets an answer.
        let tick = match self.published {
            Some((tick, _)) if self.schedule.index() == tick * self.config.world_instants() + 1 => {
                tick
            }
            _ => return,
        };
        let mut door = Door::of(&self.config, run.member.clock);
        door.asked = Some((tick, self.episode));
        let until = run.now().after_ns(self.config.world_wait_ns());
        let commands = &mut self.ports.commands;
        while !commands.newest_into(&mut self.command, |command| command.enter(&door)) {
            let now = run.now();
            if now >= until || run.member.is_stopping() {
                return;
            }
            commands.update_connections();
            run.wait_alive(until, now);
        }
    }

    /// The action to obey now: that of the newest command, or the brake.
    fn action(&mut self, run: &TickLoop, door: &Door) -> (Action, bool) {
        if !self.is_lockstep {
            let enters = |command: &Command| command.enter(door);
            self.ports.commands.newest_into(&mut self.command, enters);
            // The clock is read after the command, which otherwise would seem to come
            // from the future.
            self.now = run.now();
        }
        let limit_ns = self.config.age_limit_ns(COMMAND.row.age_limit);
        let is_contested = self.contest.look(&run.member.wire, self.now);
        let is_late = self.missed > 0 && self.config.deadlines.world == Late::Brake;
        let (now, episode) = (self.now, self.episode);
        let young = self.command.filter(|command| {
            !is_contested
                && !is_late
                && command.header.episode == episode
                && command.admit(now, limit_ns).is_ok()
        });
        (self.account.obey(young.as_ref(), now), young.is_none())
    }

    fn tick(&mut self, action: Option<(Action, bool)>) -> Tick {
        let (obeyed, braked) = action.unwrap_or((Action::BRAKE, false));
        let instants = match self.begins {
            true => 0,
            false => self.schedule.index() - self.moved,
        };
        self.moved = self.schedule.index();
        Tick {
            tick: self.schedule.tick(),
            seed: self.config.run.episode_seed(self.episode),
            scheduled_ns: self.scheduled().0,
            released_ns: self.released.0,
            taken_ns: self.now.0,
            missed: self.missed,
            step_s: instants as f64 * self.schedule.step_ns() as f64 * 1e-9,
            steer: obeyed.steer,
            pedal: obeyed.pedal,
            episode: self.episode,
            begins: u32::from(self.begins),
            braked: u32::from(braked),
            reserved: 0,
        }
    }

    fn scheduled(&self) -> Instant {
        match self.is_lockstep {
            true => self.released,
            false => self.schedule.scheduled(),
        }
    }

    /// Publishes the observation and the progress of the present instant. Headers,
    /// instants and counts are filled in here. With another outcome than `Driving` it
    /// ends the episode instead; the next tick then begins one. `Ended` when it was the
    /// run's last.
    ///
    /// # Errors
    /// When no tick waits for an answer, an episode would end as it begins, or a check
    /// refuses a message: nothing is sent then, and others may be given. When shared
    /// memory has no room: the instant is over, and its message is lost.
    pub fn finish_tick(
        &mut self,
        run: &mut TickLoop,
        door: &mut Door,
        (mut observation, progress): (Box<Observation>, Box<Progress>),
    ) -> Result<Answer, Failure> {
        if self.next != Next::Finish {
            return Err(Failure::invalid("vlaps_await_tick comes first"));
        }
        observation.header = self.header();
        observation.scheduled_ns = self.scheduled().0;
        observation.released_ns = self.released.0;
        let refused = |service: &'static str| move |refusal| Failure::refused(service, &refusal);
        observation.check().map_err(refused(OBSERVATION.name))?;
        progress.check().map_err(refused(PROGRESS.name))?;
        let outcome = Outcome::from_code(progress.outcome).unwrap_or(Outcome::Stopped);
        if self.begins && outcome != Outcome::Driving {
            return Err(ends_as_it_begins(outcome));
        }
        let mut account = self.account.clone();
        account.note(&observation.ego, &progress);
        // The way is summed up here, and may overflow.
        let episode = self.episode_of(&account, Outcome::Stopped);
        episode.check().map_err(refused(EPISODE.name))?;
        self.account = account;
        run.telemetry.end(Part::Move, run.member.now());
        if outcome != Outcome::Driving {
            return self.begin_next(run, outcome);
        }
        self.begins = false;
        self.next = Next::Await;
        if self.missed > 0 && self.config.deadlines.world == Late::Skip {
            self.record_missed(run, self.schedule.now(), self.missed + 1);
            self.note_deadline(run, run.now());
            self.schedule.move_on();
            self.report(run);
            return Ok(Answer::Ok);
        }
        let sent = self.publish(run, &mut observation);
        door.asked = Some((self.schedule.tick(), self.episode));
        self.end_instant(run);
        sent.map(|()| Answer::Ok)
    }

    /// Publishes the observation. Between two ticks of the run it wakes no reader, and
    /// says when the tick was published.
    fn publish(&mut self, run: &TickLoop, observation: &mut Observation) -> Result<(), Failure> {
        let tick = self.schedule.tick();
        if let Some((published, at)) = self.published
            && published == tick
        {
            observation.published_ns = at.0;
            return sent(
                self.ports.observations.send_quietly(observation),
                OBSERVATION.name,
            );
        }
        let now = run.now();
        self.published = Some((tick, now));
        observation.published_ns = now.0;
        let is_sent = self.ports.observations.send(observation);
        let progress = self.publish_progress(Outcome::Driving);
        self.schedule.begin();
        sent(is_sent, OBSERVATION.name).and(progress)
    }

    fn begin_next(&mut self, run: &mut TickLoop, outcome: Outcome) -> Result<Answer, Failure> {
        let closed = self.close_episode(outcome);
        let episodes = self.config.run.episodes;
        let was_last = episodes > 0 && self.episode + 1 >= episodes;
        if was_last || self.is_over(run) {
            self.record_missed(run, self.schedule.previous(), self.missed);
            self.report(run);
            self.next = Next::Exit;
            return closed.map(|()| Answer::Ended);
        }
        self.episode += 1;
        self.account = Account::new(self.config.run.episode_seed(self.episode));
        self.episode_skipped = self.schedule.skipped();
        self.command = None;
        self.begins = true;
        self.next = Next::Await;
        closed.map(|()| Answer::Ok)
    }

    fn is_over(&self, run: &TickLoop) -> bool {
        let duration_s = self.config.run.duration_s;
        let elapsed_ns = self.driven_ns + self.schedule.elapsed_ns(self.now);
        let has_passed = duration_s > 0.0 && elapsed_ns as f64 >= duration_s * 1e9;
        has_passed || run.member.is_stopping()
    }

    fn close_episode(&mut self, outcome: Outcome) -> Result<(), Failure> {
        let mut episode = self.episode_of(&self.account, outcome);
        let is_sent = self.ports.episodes.send(&mut episode);
        let progress = self.publish_progress(outcome);
        sent(is_sent, EPISODE.name).and(progress)
    }

    fn episode_of(&self, account: &Account, outcome: Outcome) -> Episode {
        let skipped = self.schedule.skipped() - self.episode_skipped;
        Episode {
            header: self.header(),
            ..account.episode(outcome, skipped)
        }
    }

    fn publish_progress(&mut self, outcome: Outcome) -> Result<(), Failure> {
        let mut progress = self.account.progress(outcome, self.schedule.skipped());
        progress.header = self.header();
        sent(self.ports.progress.send(&mut progress), PROGRESS.name)
    }

    fn header(&self) -> Header {
        Header {
            tick: self.schedule.tick(),
            taken_ns: self.now.0,
            episode: self.episode,
            ..Header::default()
        }
    }

    /// Ends the present instant: counts it, and those missed before it.
    fn end_instant(&mut self, run: &mut TickLoop) {
        let done = run.now();
        run.telemetry.end(Part::Send, done);
        let due = self.schedule.now();
        run.telemetry.record_tick(runtime::Tick {
            due: if self.is_lockstep { self.released } else { due },
            // In lockstep a command releases the instant, not the timer.
            released: (!self.is_lockstep).then_some(due),
            begun: self.released,
            done,
        });
        self.record_missed(run, self.schedule.previous(), self.missed);
        self.note_deadline(run, done);
        self.schedule.move_on();
        self.report(run);
    }

    fn record_missed(&self, run: &mut TickLoop, newest: Instant, count: u64) {
        let skipped = Skipped {
            newest,
            period_ns: self.schedule.step_ns(),
            count,
        };
        run.telemetry.record_skipped(skipped, self.released);
    }

    fn note_deadline(&self, run: &mut TickLoop, done: Instant) {
        let period_ns = self.schedule.step_ns();
        run.telemetry.note_deadline(Deadline {
            tick: self.schedule.tick(),
            deadline: self.schedule.now().after_ns(period_ns),
            done,
            skipped: self.missed,
            period_ns,
        });
    }

    fn report(&self, run: &mut TickLoop) {
        let health = &mut run.telemetry.health;
        self.schedule.report(health);
        health.header.tick = self.schedule.ticks_due().saturating_sub(1);
        health.late = self.schedule.missed();
    }
}

fn sent(is_sent: bool, service: &str) -> Result<(), Failure> {
    match is_sent {
        true => Ok(()),
        false => Err(no_space(service)),
    }
}

fn ends_as_it_begins(outcome: Outcome) -> Failure {
    Failure::invalid(format!(
        "progress: outcome = {outcome} at the tick that begins the episode; it can end at a later one"
    ))
}

/// The world's grid with this first instant.
fn schedule(config: &Config, first: Instant) -> TickSchedule {
    TickSchedule::on_timer(config.run.period_ns(), config.world_instants(), first)
}
