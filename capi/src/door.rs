//! The check that each message passes: those that a reader takes, and those that the
//! caller publishes, before they are sent.

use shm_config::config::Config;
use shm_config::message::{
    Advice, Command, Episode, Foresight, Frame, FrameRequest, Learning, Message, Observation, Plan,
    PolicyStatus, Progress, Refusal, Step, Takeover,
};
use shm_config::services::{self, AgeLimit};
use shm_config::time::Clock;
use shm_config::{Instant, RunGrid};

/// What a check needs to know of the run.
pub struct Door {
    grid: RunGrid,
    clock: Clock,
    is_lockstep: bool,
    period_ns: u64,
    observation_age_ns: u64,
    plan_age_ns: u64,
    command_age_ns: u64,
    takeover_age_ns: u64,
    /// Tick and episode of the last observation that this process published.
    pub asked: Option<(u64, u32)>,
}

impl Door {
    /// The checks of a configuration.
    pub fn of(config: &Config, clock: Clock) -> Self {
        let limit = |limit| config.age_limit_ns(limit);
        Self {
            grid: RunGrid::of(config),
            clock,
            is_lockstep: config.run.is_lockstep(),
            period_ns: config.run.period_ns(),
            observation_age_ns: limit(AgeLimit::Observation),
            plan_age_ns: limit(AgeLimit::Plan),
            command_age_ns: limit(AgeLimit::Command),
            takeover_age_ns: limit(AgeLimit::Takeover),
            asked: None,
        }
    }

    /// The machine's clock. Read it after a message was received; before, the message
    /// would seem to come from the future.
    pub fn now(&self) -> Instant {
        (self.clock)()
    }

    fn limit_ns(&self, limit: AgeLimit) -> u64 {
        match limit {
            AgeLimit::Observation => self.observation_age_ns,
            AgeLimit::Plan => self.plan_age_ns,
            AgeLimit::Command => self.command_age_ns,
            AgeLimit::Takeover => self.takeover_age_ns,
            AgeLimit::OwnExpiry | AgeLimit::None => u64::MAX,
        }
    }

    /// Content, and in real time the age. In lockstep the run's clock is the world's.
    fn admit<M: Message>(&self, message: &M, limit: AgeLimit) -> Result<(), Refusal> {
        match self.is_lockstep {
            true => message.check(),
            false => message.admit(self.now(), self.limit_ns(limit)),
        }
    }
}

/// A message with the check of its service.
pub trait Enter: Message {
    /// Checks it.
    ///
    /// # Errors
    /// As [`Message::admit`]; observations also when they are off the run's grid,
    /// commands when they are for another episode or, in lockstep, another tick.
    fn enter(&self, door: &Door) -> Result<(), Refusal>;
}

impl Enter for Observation {
    fn enter(&self, door: &Door) -> Result<(), Refusal> {
        door.grid.admit(self, door.now())
    }
}

impl Enter for Command {
    /// A process that has published an observation takes commands of its episode alone;
    /// in lockstep, the answer to it alone.
    fn enter(&self, door: &Door) -> Result<(), Refusal> {
        match (door.asked, door.is_lockstep) {
            (None, _) => door.admit(self, services::COMMAND.row.age_limit),
            (Some((tick, episode)), true) => {
                robot::door::admit_answer(self, tick, door.period_ns, episode)
            }
            (Some((_, episode)), false) => {
                robot::door::admit(self, door.now(), door.command_age_ns, episode)
            }
        }
    }
}

macro_rules! by_their_row {
    ($($message:ty: $service:ident,)+) => { $(
        impl Enter for $message {
            fn enter(&self, door: &Door) -> Result<(), Refusal> {
                door.admit(self, services::$service.row.age_limit)
            }
        }
    )+ };
}
by_their_row! {
    Plan: PLAN,
    Step: STEP,
    Advice: ADVICE,
    Takeover: TAKEOVER,
    FrameRequest: FRAME_REQUEST,
    Frame: FRAME,
    Foresight: FORESIGHT,
    Learning: LEARNING,
    PolicyStatus: POLICY_STATUS,
    Progress: PROGRESS,
    Episode: EPISODE,
}
