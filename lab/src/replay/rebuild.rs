//! The built-in world, moved again as a recorded run moved it.
//!
//! An observation says which action was applied last, so the world follows from the seed and
//! the observations' actions; which command each action is of follows from the instants at
//! which commands were sent. Brakes on silence, instants that were missed, and instants
//! between two ticks are in the observations' ticks and instants.

use shm_config::Instant;
use shm_config::config::{Config, DECISION_HZ, Late};
use shm_config::message::{
    Command, Episode, Header, Lateness, Observation, Outcome, Progress, Step,
};
use shm_config::services::COMMAND;
use sim::score::Score;
use sim::substeps::Substeps;
use sim::{StepOutcome, World, WorldConfig, WorldError};
use vehicle::Action;

/// Commands around the newest one that an action is looked for in. The world reads its port
/// at most a few ticks away from the instant that it notes.
const NEAR: usize = 6;

/// Largest tick that is believed: at 10,000 Hz three years.
const TICKS_MAX: u64 = 1 << 40;

/// What the world applied at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Applied {
    /// A command of the controller.
    Command(Command),
    /// The brake, because no command was young enough.
    Brake,
}

impl Applied {
    fn action(&self) -> Action {
        match self {
            Applied::Command(command) => command.action(),
            Applied::Brake => Action::BRAKE,
        }
    }

    fn command(&self) -> Option<&Command> {
        match self {
            Applied::Command(command) => Some(command),
            Applied::Brake => None,
        }
    }
}

/// The commands that were sent, in order, each with the instant at which it was.
#[derive(Clone, Debug, Default)]
pub struct Sent {
    commands: Vec<(u64, Command)>,
}

impl Sent {
    /// Of these steps, in order.
    pub fn new<'a>(steps: impl IntoIterator<Item = &'a Step>) -> Self {
        let mut sent = Self::default();
        steps.into_iter().for_each(|step| sent.push(step));
        sent
    }

    /// Adds the command of the next step, if it was sent.
    pub fn push(&mut self, step: &Step) {
        if step.lateness != Lateness::HeldBack.code() {
            let sent = (step.timings.commanded_ns, step.command);
            self.commands.push(sent);
        }
    }

    /// The commands around an instant of the machine's clock: the newest one sent by then,
    /// the next one, which was perhaps read before its sender had noted the time, then older
    /// ones.
    fn around(&self, released_ns: u64) -> impl Iterator<Item = &Command> {
        self.before(
            self.commands
                .partition_point(|(sent_ns, _)| *sent_ns <= released_ns),
        )
    }

    /// The last commands of an episode, the newest first.
    fn last_of(&self, episode: u32) -> impl Iterator<Item = &Command> {
        let is_before = |(_, command): &(u64, Command)| command.header.episode <= episode;
        self.before(self.commands.partition_point(is_before))
    }

    fn before(&self, next: usize) -> impl Iterator<Item = &Command> {
        let newest = next.checked_sub(1);
        let older = (2..NEAR).filter_map(move |back| next.checked_sub(back));
        let order = newest.into_iter().chain([next]).chain(older);
        order.filter_map(|index| Some(&self.commands.get(index)?.1))
    }
}

/// One instant of the world.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// The world's header at it.
    pub header: Header,
    /// When the run's tick was due; the machine's clock.
    pub scheduled_ns: u64,
    /// When the instant began; the machine's clock.
    pub released_ns: u64,
}

impl Moment {
    /// Of an observation.
    pub fn of(observation: &Observation) -> Self {
        Self {
            header: observation.header,
            scheduled_ns: observation.scheduled_ns,
            released_ns: observation.released_ns,
        }
    }
}

/// Why a world cannot be moved on.
#[derive(Clone, Debug, PartialEq)]
pub enum Astray {
    /// Observations are missing.
    Gap,
    /// No command that was sent has the action that was applied.
    NoCommand {
        /// The newest command's action.
        newest: Option<Action>,
    },
}

impl std::fmt::Display for Astray {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Astray::Gap => write!(f, "an observation before it is not in the recording"),
            Astray::NoCommand { newest: None } => write!(f, "no recorded command was applied"),
            Astray::NoCommand {
                newest: Some(Action { steer, pedal }),
            } => write!(
                f,
                "the applied action is of no recorded command; the newest has steer {steer}, \
                 pedal {pedal}"
            ),
        }
    }
}

/// The world of one episode.
#[derive(Clone)]
pub struct Rebuilt {
    /// The world after the last instant.
    pub world: World,
    /// Its account.
    pub score: Score,
    /// The sub-steps made.
    pub substeps: Substeps,
    /// Of the last instant, counted from the first one of the process.
    pub index: u64,
    /// The last observation's header.
    pub header: Header,
    /// The command that was applied last.
    pub applied: Option<Applied>,
}

/// The configuration's part that moves the world.
#[derive(Clone, Debug)]
pub struct Mover {
    config: Config,
    instants: u64,
    period_ns: u64,
    limit_ns: u64,
}

impl Mover {
    /// Of this configuration.
    pub fn new(config: &Config) -> Self {
        Self {
            instants: config.world_instants(),
            period_ns: config.run.period_ns(),
            limit_ns: config.age_limit_ns(COMMAND.row.age_limit),
            config: config.clone(),
        }
    }

    /// Instants of the world in one tick of the run.
    pub fn instants(&self) -> u64 {
        self.instants
    }

    /// A world of this configuration.
    ///
    /// # Errors
    /// When the configuration is out of range.
    pub fn world(&self) -> Result<World, WorldError> {
        World::new(WorldConfig::from(&self.config))
    }

    /// Begins the episode of its first observation with this world.
    ///
    /// # Errors
    /// When its seed has no map.
    pub fn begin(&self, mut world: World, first: &Observation) -> Result<Rebuilt, WorldError> {
        let seed = self.config.run.episode_seed(first.header.episode);
        world.reset(seed)?;
        let hold = (self.config.world_rate_hz() / DECISION_HZ).round() as u64;
        let mut substeps = Substeps::new(hold);
        let index = self.index(&Moment::of(first), 0);
        let is_late = first.header.sequence == 1 && index > 0;
        if !is_late {
            substeps.take(index);
        }
        let mut rebuilt = Rebuilt {
            world,
            score: Score::new(seed),
            substeps,
            index,
            header: first.header,
            applied: None,
        };
        if is_late {
            // The world was late for its first instant, and had no command yet.
            self.advance(&mut rebuilt, index, &Applied::Brake);
        }
        Ok(rebuilt)
    }

    /// The number of an instant; at least `least`.
    fn index(&self, moment: &Moment, least: u64) -> u64 {
        let (tick, parts) = (moment.header.tick, self.instants);
        let part = match self.config.run.is_lockstep() {
            true => {
                let begun_ns = tick.saturating_mul(self.period_ns);
                let off_ns = moment.header.taken_ns.saturating_sub(begun_ns);
                off_ns.saturating_mul(parts).div_ceil(self.period_ns)
            }
            false => {
                let off_ns = moment.released_ns.saturating_sub(moment.scheduled_ns);
                off_ns.saturating_mul(parts) / self.period_ns
            }
        };
        let index = tick.min(TICKS_MAX) * parts + part.min(parts - 1);
        index.max(least)
    }

    /// Whether instants were moved in that no observation shows.
    fn hides(&self, passed: u64) -> bool {
        passed > 1 && self.config.deadlines.world == Late::Skip
    }

    /// What was applied between the last instant and this one: the action that the
    /// observation shows, and the command of it. `braked` is the recorded count of brakes on
    /// silence, where it is known.
    fn applied(
        &self,
        rebuilt: &Rebuilt,
        (observation, braked): (&Observation, Option<u64>),
        sent: &Sent,
    ) -> Result<Applied, Astray> {
        let ego = &observation.ego;
        let wanted = (ego.steer.to_bits(), ego.pedal.to_bits());
        let bits = |action: Action| (action.steer.to_bits(), action.pedal.to_bits());
        let is_brake = wanted == bits(Action::BRAKE);
        let counted = rebuilt.score.progress(&rebuilt.world, Outcome::Driving);
        if is_brake && braked.is_some_and(|braked| braked > counted.braked) {
            return Ok(Applied::Brake);
        }
        let matching = || {
            let commands = self.admissible(Moment::of(observation), sent);
            commands.filter(|command| bits(command.action()) == wanted)
        };
        // In lockstep the world waits for the answer to its last tick.
        let asked = observation.header.tick.saturating_sub(1);
        let is_answer = |command: &&Command| command.header.tick == asked;
        let answer = matching().find(is_answer);
        let answer = answer.filter(|_| self.config.run.is_lockstep());
        let found = answer.or_else(|| matching().next());
        match found {
            Some(command) => Ok(Applied::Command(*command)),
            None if is_brake => Ok(Applied::Brake),
            None => {
                let newest = self.admissible(Moment::of(observation), sent).next();
                let newest = newest.map(Command::action);
                Err(Astray::NoCommand { newest })
            }
        }
    }

    /// The commands that the world may have applied at an instant, the likeliest first.
    fn admissible<'a>(
        &'a self,
        moment: Moment,
        sent: &'a Sent,
    ) -> impl Iterator<Item = &'a Command> {
        let header = moment.header;
        let near = sent.around(moment.released_ns);
        near.filter(move |command| self.is_admissible(&header, command))
    }

    /// Whether the world admits a command at the instant of this header.
    fn is_admissible(&self, at: &Header, command: &Command) -> bool {
        let age_ns = at.taken_ns.saturating_sub(command.header.taken_ns);
        command.header.episode == at.episode && age_ns <= self.limit_ns
    }

    /// The commands that the world may have applied when an episode ended.
    fn last_admissible(&self, header: &Header, sent: &Sent) -> Vec<Applied> {
        let is_admissible = |command: &&Command| self.is_admissible(header, command);
        // In lockstep the run's clock is not the machine's.
        let commands: Vec<&Command> = match self.config.run.is_lockstep() {
            true => sent.last_of(header.episode).filter(is_admissible).collect(),
            false => sent.around(header.taken_ns).filter(is_admissible).collect(),
        };
        let commands = commands.into_iter();
        commands.map(|command| Applied::Command(*command)).collect()
    }

    /// The number of a recorded observation's instant, and what was applied there.
    ///
    /// # Errors
    /// When it cannot be told.
    pub fn identify(
        &self,
        rebuilt: &Rebuilt,
        (recorded, braked): (&Observation, Option<u64>),
        sent: &Sent,
    ) -> Result<(u64, Applied), Astray> {
        let is_next = recorded.header.sequence == rebuilt.header.sequence.wrapping_add(1);
        let index = self.index(&Moment::of(recorded), rebuilt.index + 1);
        if !is_next || self.hides(index - rebuilt.index) {
            return Err(Astray::Gap);
        }
        let due = rebuilt.substeps.clone().take(index);
        let applied = match due {
            // No sub-step was due: what was applied before goes on.
            0 => rebuilt.applied.unwrap_or(Applied::Brake),
            _ => self.applied(rebuilt, (recorded, braked), sent)?,
        };
        Ok((index, applied))
    }

    /// Moves the world to the instant of a recorded observation, and observes.
    ///
    /// # Errors
    /// When what was applied cannot be told.
    pub fn follow(
        &self,
        rebuilt: &mut Rebuilt,
        recorded: (&Observation, Option<u64>),
        sent: &Sent,
    ) -> Result<Box<Observation>, Astray> {
        let (index, applied) = self.identify(rebuilt, recorded, sent)?;
        self.advance(rebuilt, index, &applied);
        rebuilt.header = recorded.0.header;
        Ok(observe(rebuilt, recorded.0))
    }

    /// Moves the world to an instant with what is applied. Returns the episode's end.
    pub fn advance(
        &self,
        rebuilt: &mut Rebuilt,
        index: u64,
        applied: &Applied,
    ) -> Option<StepOutcome> {
        let due = rebuilt.substeps.take(index);
        rebuilt.index = index;
        if due == 0 {
            return None;
        }
        rebuilt.applied = Some(*applied);
        // The age of the command is not recomputed: no message says when it was read.
        rebuilt.score.obey(applied.command(), Instant(0));
        for _ in 0..due {
            if let Some(step) = rebuilt.world.substep(applied.action()) {
                rebuilt.score.count(&step);
                if step.has_ended() {
                    return Some(step);
                }
            }
        }
        None
    }

    /// Ends the episode as the recorded message says, and gives the message that follows from
    /// the world; the likeliest command that gives it.
    pub fn end(&self, rebuilt: &Rebuilt, recorded: &Episode, sent: &Sent) -> (Rebuilt, Episode) {
        self.end_with(rebuilt, recorded, sent, |_| None)
    }

    /// The same; `own` gives the commands that are applied in place of recorded ones.
    pub fn end_with(
        &self,
        rebuilt: &Rebuilt,
        recorded: &Episode,
        sent: &Sent,
        own: impl Fn(&Command) -> Option<Command>,
    ) -> (Rebuilt, Episode) {
        let header = recorded.header;
        let index = match self.instants {
            1 => header.tick.max(rebuilt.index + 1),
            _ => rebuilt.index + 1,
        };
        let mut first = None;
        let commands = self.last_admissible(&header, sent);
        for applied in commands.into_iter().chain([Applied::Brake]) {
            let mut ended = rebuilt.clone();
            let applied = match applied {
                Applied::Command(command) => Applied::Command(own(&command).unwrap_or(command)),
                Applied::Brake => Applied::Brake,
            };
            let end = self.advance(&mut ended, index, &applied);
            let outcome = end.map_or(Outcome::Stopped, |step| step.outcome);
            let episode = Episode {
                header,
                skipped: recorded.skipped,
                ..ended.score.episode(&ended.world, outcome)
            };
            let is_it = &episode == recorded;
            if is_it {
                return (ended, episode);
            }
            first.get_or_insert((ended, episode));
        }
        // The brake is always tried.
        first.unwrap_or_else(|| (rebuilt.clone(), *recorded))
    }
}

/// What is observed now, under the header and instants of a recorded observation.
pub fn observe(rebuilt: &Rebuilt, recorded: &Observation) -> Box<Observation> {
    let mut observation = Box::new(Observation {
        header: recorded.header,
        scheduled_ns: recorded.scheduled_ns,
        released_ns: recorded.released_ns,
        published_ns: recorded.published_ns,
        ..Observation::default()
    });
    let share = rebuilt.substeps.share(rebuilt.index);
    rebuilt.world.observe_between(share, &mut observation);
    observation
}

/// The progress that follows from the world, under the header of a recorded one.
pub fn progress(rebuilt: &Rebuilt, recorded: &Progress) -> Progress {
    Progress {
        header: recorded.header,
        skipped: recorded.skipped,
        // No message says when the world read a command.
        command_age_max_ns: recorded.command_age_max_ns,
        ..rebuilt.score.progress(&rebuilt.world, Outcome::Driving)
    }
}
