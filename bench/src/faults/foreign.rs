//! A foreign process: one of the same user that the run did not start. It sends
//! well-formed messages, occupies ports, or holds messages that it has received.

use std::time::Duration;

use shm_config::Instant;
use shm_config::message::{Command, Episode, Health, HealthState, Message, Progress, Step};
use shm_config::services::{
    self, ADVICE, COMMAND, EPISODE, OBSERVATION, PLAN, PROGRESS, Process, STEP,
};
use shm_config::wire::{Doorbell, Publisher, Subscriber, Wire, WireError};
use supervisor::machine::signals::pause;

/// Steering of the forged commands. No driver of the set steers exactly so, so that a
/// world that obeys a forged command is recognised.
pub(super) const FORGED_STEER: f64 = 0.123_456_789;

/// Number of episodes by which the forged episode is ahead of the run's.
const EPISODES_AHEAD: u32 = 7;
/// Ports of one kind that the process tries to take.
const PORTS_MAX: usize = 40;
/// Subscribers that hold a message.
const HOLDERS: usize = 4;

/// The messages that are forged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Forgery {
    /// Commands of the current episode.
    Command,
    /// Commands of another episode.
    OtherEpisode,
    /// Observations half a period off the grid.
    Observation,
    /// Plans and advice.
    PlanAndAdvice,
    /// Health reports, progress and finished episodes.
    Health,
}

/// A foreign process that sends forged messages.
pub struct ForeignProcess {
    forgery: Forgery,
    commands: Publisher<Command>,
    observations: Publisher<shm_config::message::Observation>,
    plans: Publisher<shm_config::message::Plan>,
    advices: Publisher<shm_config::message::Advice>,
    progress: Publisher<Progress>,
    episodes: Publisher<Episode>,
    healths: Vec<Publisher<Health>>,
    sent: u32,
}

impl ForeignProcess {
    /// Opens its publishers.
    ///
    /// # Errors
    /// If shared memory refuses.
    pub fn open(wire: &Wire, forgery: Forgery) -> Result<Self, WireError> {
        let healths = [Process::World, Process::Planner, Process::Controller];
        let healths = healths.map(|process| wire.publisher(services::health(process)));
        Ok(Self {
            forgery,
            commands: wire.publisher(COMMAND)?,
            observations: wire.publisher(OBSERVATION)?,
            plans: wire.publisher(PLAN)?,
            advices: wire.publisher(ADVICE)?,
            progress: wire.publisher(PROGRESS)?,
            episodes: wire.publisher(EPISODE)?,
            healths: healths.into_iter().collect::<Result<_, _>>()?,
            sent: 0,
        })
    }

    /// Sends one forged message, derived from the newest step.
    pub fn send(&mut self, step: &Step, now: Instant, period_ns: u64) {
        self.sent += 1;
        match self.forgery {
            Forgery::Command => {
                self.commands.send(&mut command(step, now));
            }
            Forgery::OtherEpisode => {
                let mut command = command(step, now);
                command.header.episode += EPISODES_AHEAD;
                self.commands.send(&mut command);
            }
            Forgery::Observation => {
                let mut observation = step.observation;
                observation.header.taken_ns = now.0;
                observation.scheduled_ns += period_ns / 2;
                // Every other message is malformed, too.
                if self.sent.is_multiple_of(2) {
                    observation.ego.speed_mps = f64::NAN;
                }
                self.observations.send(&mut observation);
            }
            Forgery::PlanAndAdvice => {
                let (mut plan, mut advice) = (step.plan, step.advice);
                plan.header.taken_ns = now.0;
                advice.header.taken_ns = now.0;
                (advice.preference, advice.answers) = (2, u64::MAX);
                advice.holds_until_ns = u64::MAX;
                self.plans.send(&mut plan);
                self.advices.send(&mut advice);
            }
            Forgery::Health => self.forge_health(step, now),
        }
    }

    fn forge_health(&mut self, step: &Step, now: Instant) {
        let mut header = step.header;
        header.taken_ns = now.0;
        for port in &mut self.healths {
            let mut health = Health {
                header,
                ticks: u64::from(self.sent) << 32,
                state: HealthState::Finished.code(),
                ..Health::default()
            };
            port.send(&mut health);
        }
        header.episode = u32::MAX;
        let (mut progress, mut episode) = (Progress::default(), Episode::default());
        (progress.header, episode.header) = (header, header);
        self.progress.send(&mut progress);
        self.episodes.send(&mut episode);
    }
}

/// A forged command that a world would obey if the run's controller had sent it.
pub fn command(step: &Step, now: Instant) -> Command {
    let mut command = step.command;
    command.header.taken_ns = now.0;
    command.header.tick = step.header.tick + 1;
    (command.steer, command.pedal) = (FORGED_STEER, 1.0);
    command
}

/// Whether a step is based on forged messages, as far as the step shows; in words.
pub fn forgery_in(step: &Step, foreign: u32) -> Option<&'static str> {
    let is_from = |producer: u32| producer == foreign;
    if is_from(step.observation.header.producer) {
        return Some("based on a foreign observation");
    }
    if is_from(step.plan.header.producer) {
        return Some("based on a foreign plan");
    }
    if is_from(step.advice.header.producer) || is_from(step.takeover.header.producer) {
        return Some("based on foreign advice or a foreign takeover");
    }
    let obeyed = step.observation.ego.steer == FORGED_STEER;
    obeyed.then_some("the world obeyed a foreign command")
}

/// All ports that a foreign process can take in the services of a tick: while they are
/// held, a restarted process finds none.
pub struct HeldPorts {
    _commands: Vec<Publisher<Command>>,
    _observations: Vec<Publisher<shm_config::message::Observation>>,
    _plans: Vec<Publisher<shm_config::message::Plan>>,
    _bells: Vec<Doorbell>,
}

impl HeldPorts {
    /// Takes all ports.
    pub fn take(wire: &Wire) -> Self {
        fn all<T>(open: impl Fn() -> Result<T, WireError>) -> Vec<T> {
            (0..PORTS_MAX).map_while(|_| open().ok()).collect()
        }
        Self {
            _commands: all(|| wire.publisher(COMMAND)),
            _observations: all(|| wire.publisher(OBSERVATION)),
            _plans: all(|| wire.publisher(PLAN)),
            _bells: all(|| wire.doorbell(Process::Controller)),
        }
    }
}

/// Holds received messages for a moment; the publisher's loaned samples stay loaned.
///
/// # Errors
/// If shared memory refuses.
pub fn hold_loans(wire: &Wire, moment: Duration) -> Result<(), WireError> {
    fn hold<M: Message>(readers: &mut [Subscriber<M>], moment: Duration) {
        match readers.split_first_mut() {
            // A subscriber without a message is skipped.
            Some((first, rest)) => match first.visit(|_| hold(rest, moment)) {
                Some(()) => {}
                None => hold(rest, moment),
            },
            None => pause(moment),
        }
    }
    let mut steps = Vec::new();
    for _ in 0..HOLDERS {
        steps.push(wire.subscriber(STEP)?);
    }
    // Two ticks at 10 Hz: one message for each subscriber.
    pause(Duration::from_millis(200));
    hold(&mut steps, moment);
    Ok(())
}
