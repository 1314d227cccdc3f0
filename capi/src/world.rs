//! The world's side of a run: the clock of `robot`, in steps that the caller takes.

use robot::clock::{Begin, WorldClock};
use robot::ports::Ports;
use runtime::{Member, TickLoop};
use shm_config::message::{Episode, Message, Observation, Outcome, Part, Progress};
use shm_config::services::{EPISODE, OBSERVATION, PROGRESS};
use vehicle::Action;

use crate::account::Account;
use crate::door::Door;
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

/// The services that the loop publishes.
pub const PUBLISHED: &[&str] = &[OBSERVATION.name, PROGRESS.name, EPISODE.name];

/// What the world has to do next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Next {
    /// Connect, and take the first instant of the grid.
    Start,
    /// Await an instant.
    Await,
    /// Begin an episode at the present instant.
    Begin,
    /// Answer the instant.
    Finish,
    /// Exit: the run is over.
    Exit,
}

/// A world between its ports.
pub struct WorldSide {
    ports: Ports,
    clock: WorldClock,
    next: Next,
    account: Account,
    /// An episode begins at the present instant.
    begins: bool,
    /// Instants that had passed when the world moved last.
    moved: u64,
}

impl WorldSide {
    /// Opens its ports.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub fn open(member: &Member, begin: Begin) -> Result<Self, Failure> {
        let seed = member.config.run.episode_seed(begin.first_episode);
        Ok(Self {
            ports: Ports::open(&member.wire)?,
            clock: WorldClock::new(&member.config, begin),
            next: Next::Start,
            account: Account::new(seed),
            begins: true,
            moved: 0,
        })
    }

    /// Waits for the next instant and takes the newest command. `None` when the run is
    /// over: the last episode is published, and the world exits with 0.
    ///
    /// # Errors
    /// When the instant before was not answered, or the last episode cannot be sent.
    pub fn await_tick(&mut self, run: &mut TickLoop) -> Result<Option<Tick>, Failure> {
        self.ports.update_connections();
        match self.next {
            Next::Start => {
                self.clock.start(run);
                self.await_instant(run);
            }
            Next::Await => self.await_instant(run),
            Next::Begin => {}
            Next::Exit => return Ok(None),
            Next::Finish => {
                let text = "vlaps_finish_tick has to answer the last tick first";
                return Err(Failure::invalid(text));
            }
        }
        let mut obeyed = None;
        if !self.begins {
            let (moment, command) = self.clock.command(run, &mut self.ports);
            let action = self.account.obey(&moment, command.as_ref());
            obeyed = Some((action, command.is_none()));
            if self.clock.is_over(run) {
                let closed = self.close_episode(Outcome::Stopped);
                return self.exit(run, closed).map(|()| None);
            }
        }
        self.next = Next::Finish;
        Ok(Some(self.tick(obeyed)))
    }

    fn await_instant(&mut self, run: &mut TickLoop) {
        while !self.clock.await_instant(run, &mut self.ports) {
            run.telemetry.heartbeat(run.now());
            self.ports.update_connections();
        }
        run.telemetry.begin(self.clock.released());
    }

    fn tick(&mut self, obeyed: Option<(Action, bool)>) -> Tick {
        let (action, braked) = obeyed.unwrap_or((Action::BRAKE, false));
        let moment = self.clock.moment();
        let instants = match self.begins {
            true => 0,
            false => moment.index - self.moved,
        };
        self.moved = moment.index;
        Tick {
            tick: moment.tick,
            seed: self.account.seed(),
            scheduled_ns: self.clock.scheduled().0,
            released_ns: self.clock.released().0,
            taken_ns: moment.now.0,
            missed: moment.missed,
            step_s: instants as f64 * self.clock.step_ns() as f64 * 1e-9,
            steer: action.steer,
            pedal: action.pedal,
            episode: self.clock.episode(),
            begins: u32::from(self.begins),
            braked: u32::from(braked),
            reserved: 0,
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
        (observation, progress): (&mut Observation, &Progress),
    ) -> Result<Answer, Failure> {
        if self.next != Next::Finish {
            return Err(Failure::invalid("vlaps_await_tick comes first"));
        }
        self.clock.date(observation);
        let refused = |service: &'static str| move |refusal| Failure::refused(service, &refusal);
        observation.check().map_err(refused(OBSERVATION.name))?;
        progress.check().map_err(refused(PROGRESS.name))?;
        let outcome = Outcome::from_code(progress.outcome).unwrap_or(Outcome::Stopped);
        if self.begins && outcome != Outcome::Driving {
            return Err(ends_as_it_begins(outcome));
        }
        let mut account = self.account.clone();
        account.note(&observation.ego, progress);
        // The way is summed up here, and may overflow.
        let episode = episode_of(&account, &self.clock, Outcome::Stopped);
        episode.check().map_err(refused(EPISODE.name))?;
        self.account = account;
        run.telemetry.end(Part::Move, run.now());
        if outcome != Outcome::Driving {
            return self.begin_next(run, outcome);
        }
        self.begins = false;
        self.next = Next::Await;
        if self.clock.is_to_skip() {
            self.clock.skip_instant(run);
            return Ok(Answer::Ok);
        }
        let (ports, account) = (&mut self.ports, &self.account);
        let mut told = Ok(());
        let is_sent = self.clock.publish(run, ports, observation, |clock, ports| {
            told = publish_progress(account, clock, ports, Outcome::Driving);
        });
        door.asked = Some((self.clock.tick(), self.clock.episode()));
        self.clock.end_instant(run);
        sent(is_sent, OBSERVATION.name)
            .and(told)
            .map(|()| Answer::Ok)
    }

    fn begin_next(&mut self, run: &mut TickLoop, outcome: Outcome) -> Result<Answer, Failure> {
        let closed = self.close_episode(outcome);
        if self.clock.is_last_episode() || self.clock.is_over(run) {
            return self.exit(run, closed).map(|()| Answer::Ended);
        }
        self.clock.begin_next_episode();
        self.account = Account::new(self.clock.seed());
        self.begins = true;
        self.next = Next::Begin;
        closed.map(|()| Answer::Ok)
    }

    fn exit(&mut self, run: &mut TickLoop, closed: Result<(), Failure>) -> Result<(), Failure> {
        self.clock.record_missed(run);
        self.clock.report(run);
        self.next = Next::Exit;
        closed
    }

    fn close_episode(&mut self, outcome: Outcome) -> Result<(), Failure> {
        let mut episode = episode_of(&self.account, &self.clock, outcome);
        let is_sent = self.ports.episodes.send(&mut episode);
        let progress = publish_progress(&self.account, &self.clock, &mut self.ports, outcome);
        sent(is_sent, EPISODE.name).and(progress)
    }
}

fn episode_of(account: &Account, clock: &WorldClock, outcome: Outcome) -> Episode {
    let (_, skipped) = clock.skipped();
    Episode {
        header: clock.header(),
        ..account.episode(outcome, skipped)
    }
}

fn publish_progress(
    account: &Account,
    clock: &WorldClock,
    ports: &mut Ports,
    outcome: Outcome,
) -> Result<(), Failure> {
    let (skipped, _) = clock.skipped();
    let mut progress = account.progress(outcome, skipped);
    progress.header = clock.header();
    sent(ports.progress.send(&mut progress), PROGRESS.name)
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
