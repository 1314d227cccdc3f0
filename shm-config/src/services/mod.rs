//! The service table: every flow of data between two processes is one row.
//!
//! | service | from | to | what |
//! |---|---|---|---|
//! | `observation` | world | planner, controller | what the car perceives, at every instant of the world; those between two ticks wake nobody |
//! | `plan` | planner | controller | the answer to one observation, at the planner's rate |
//! | `command` | controller | world | what the car shall do |
//! | `step` | controller | gate, learner, supervisor | the record of one tick; a queue |
//! | `advice` | gate | controller | who should drive, until when |
//! | `takeover` | supervisor | controller | what a person at the keys wants, at 20 Hz; wakes nobody: a tick takes the newest |
//! | `frame_request` | gate | world | which picture is wanted; wakes nobody: a thread beside the tick looks for it |
//! | `frame` | world | gate | a picture of the scene, on demand |
//! | `foresight` | world | gate | what holding either proposal would lead to; a simulator's, for the record alone |
//! | `weights` | learner, `swap` | controller | a policy file offered for adoption; wakes nobody: a thread beside the tick looks for it |
//! | `learning` | learner | controller | how far the learner is |
//! | `policy_status` | controller | learner, supervisor | what became of it |
//! | `progress` | world | supervisor | how the episode goes |
//! | `episode` | world | supervisor | how an episode ended; a queue |
//! | `health/*` | each process | supervisor | how the process does |
//! | `timing/*` | each process | supervisor | how punctual it is |
//! | `roster` | supervisor | every process | which process ids the run has started; a reader takes state from no other |
//! | `fault` | `bench faults` | each process, with `run.faults` alone | an order to fail; a queue, so that nobody who is restarted gets an old one |

use std::marker::PhantomData;

use crate::message::{
    Advice, Command, Episode, Fault, Foresight, Frame, FrameRequest, Health, Learning, Observation,
    Plan, PolicyStatus, Progress, Roster, Step, Takeover, Timing, Weights,
};

crate::word_list! {
    /// The processes of a run.
    pub enum Process {
        /// Starts, watches, restarts and stops the others.
        Supervisor = 0 "supervisor",
        /// Owns the clock and the car: the built-in world, MetaDrive, or a robot.
        World = 1 "world",
        /// Observation to plan.
        Planner = 2 "planner",
        /// Plan, policy and verdict to command.
        Controller = 3 "controller",
        /// Frame to advice.
        Gate = 4 "gate",
        /// Steps to weights.
        Learner = 5 "learner",
    }
}

/// What a reader finds when it looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// The newest message; older ones are gone. Late joiners get it too.
    Latest,
    /// Every message, up to this many behind; then the oldest are lost and the
    /// gap in the sequence tells how many.
    Queue(usize),
}

impl Delivery {
    /// How many messages a reader may fall behind, and how many a late joiner
    /// still gets.
    pub const fn queue(self) -> (usize, usize) {
        match self {
            Self::Latest => (1, 1),
            Self::Queue(depth) => (depth, 0),
        }
    }
}

/// From which processes a reader takes the messages of a service.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TakenFrom {
    /// From the one that the run has started as the row's producer.
    Producer,
    /// From every process of the user: offers and requests, which decide nothing by
    /// themselves and are checked for what they are.
    Anyone,
}

/// One row of the service table.
#[derive(Debug, Clone, Copy)]
pub struct Service<M> {
    /// The name on the wire.
    pub name: &'static str,
    /// Who publishes. More than one of a kind may exist for a moment while a
    /// dead one is being replaced.
    pub from: Process,
    /// Who is woken by it.
    pub to: &'static [Process],
    /// What a reader finds.
    pub delivery: Delivery,
    /// From which processes a reader takes it.
    pub taken_from: TakenFrom,
    message: PhantomData<fn() -> M>,
}

impl<M> Service<M> {
    /// A service outside the table, such as a test needs.
    pub const fn custom(
        name: &'static str,
        from: Process,
        to: &'static [Process],
        delivery: Delivery,
    ) -> Self {
        Self {
            name,
            from,
            to,
            delivery,
            taken_from: TakenFrom::Producer,
            message: PhantomData,
        }
    }

    /// The same, taken from every process of the user.
    const fn open(self) -> Self {
        Self {
            taken_from: TakenFrom::Anyone,
            ..self
        }
    }
}

/// Steps a slow reader may fall behind: over six minutes at 10 Hz, 18 MB.
pub const STEP_QUEUE: usize = 4096;
/// Episodes a slow reader may fall behind.
pub const EPISODE_QUEUE: usize = 256;
/// Orders to fail that a slow reader may fall behind.
pub const FAULT_QUEUE: usize = 16;

use Delivery::{Latest, Queue};
use Process as P;

/// What the car perceives, at every instant of the world.
pub const OBSERVATION: Service<Observation> = Service::custom(
    "observation",
    P::World,
    &[P::Planner, P::Controller],
    Latest,
);
/// The answer to one observation.
pub const PLAN: Service<Plan> = Service::custom("plan", P::Planner, &[P::Controller], Latest);
/// What the car shall do.
pub const COMMAND: Service<Command> =
    Service::custom("command", P::Controller, &[P::World], Latest);
/// The record of every tick.
pub const STEP: Service<Step> = Service::custom(
    "step",
    P::Controller,
    &[P::Gate, P::Learner],
    Queue(STEP_QUEUE),
);
/// Who should drive, until when.
pub const ADVICE: Service<Advice> = Service::custom("advice", P::Gate, &[P::Controller], Latest);
/// What a person at the keys wants. No bell rings: a tick takes the newest, and
/// has no use for being woken twenty times a second.
pub const TAKEOVER: Service<Takeover> = Service::custom("takeover", P::Supervisor, &[], Latest);
/// Which picture is wanted. No bell rings: it would wake the tick's thread, and the
/// photographer beside it looks every few milliseconds.
pub const FRAME_REQUEST: Service<FrameRequest> =
    Service::custom("frame_request", P::Gate, &[], Latest).open();
/// A picture of the scene.
pub const FRAME: Service<Frame> = Service::custom("frame", P::World, &[P::Gate], Latest);
/// What holding either proposal would lead to; for the record alone.
pub const FORESIGHT: Service<Foresight> =
    Service::custom("foresight", P::World, &[P::Gate], Latest);
/// A policy file offered for adoption. No bell rings: it would wake the tick's
/// thread, and the loader beside it looks every few milliseconds.
pub const WEIGHTS: Service<Weights> = Service::custom("weights", P::Learner, &[], Latest).open();
/// How far the learner is.
pub const LEARNING: Service<Learning> =
    Service::custom("learning", P::Learner, &[P::Controller], Latest);
/// What became of an offered policy.
pub const POLICY_STATUS: Service<PolicyStatus> =
    Service::custom("policy_status", P::Controller, &[P::Learner], Latest);
/// How the episode goes.
pub const PROGRESS: Service<Progress> = Service::custom("progress", P::World, &[], Latest);
/// How an episode ended.
pub const EPISODE: Service<Episode> =
    Service::custom("episode", P::World, &[], Queue(EPISODE_QUEUE));

/// An order to fail. No bell rings: each process looks for it between two ticks.
pub const FAULT: Service<Fault> =
    Service::custom("fault", P::Supervisor, &[], Queue(FAULT_QUEUE)).open();

/// Which processes the run has started. No bell rings: a reader looks for it when a
/// message comes from a process that it does not know.
pub const ROSTER: Service<Roster> = Service::custom("roster", P::Supervisor, &[], Latest);

/// How a process does.
pub const fn health(process: Process) -> Service<Health> {
    let name = match process {
        P::Supervisor => "health/supervisor",
        P::World => "health/world",
        P::Planner => "health/planner",
        P::Controller => "health/controller",
        P::Gate => "health/gate",
        P::Learner => "health/learner",
    };
    Service::custom(name, process, &[], Latest)
}

/// How punctual a process is.
pub const fn timing(process: Process) -> Service<Timing> {
    let name = match process {
        P::Supervisor => "timing/supervisor",
        P::World => "timing/world",
        P::Planner => "timing/planner",
        P::Controller => "timing/controller",
        P::Gate => "timing/gate",
        P::Learner => "timing/learner",
    };
    Service::custom(name, process, &[], Latest)
}
