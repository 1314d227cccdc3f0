//! The contents of one row of the service table.

use core::marker::PhantomData;

use crate::layout::{Layout, Table};
use crate::word_list;

word_list! {
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
        /// Every recorded message to files.
        Recorder = 6 "recorder",
    }
}

impl Process {
    /// The name of its program; a world outside this repository has another.
    pub const fn binary(self) -> &'static str {
        match self {
            Self::Supervisor => "vlaps-supervisor",
            Self::World => "vlaps-world",
            Self::Planner => "vlaps-planner",
            Self::Controller => "vlaps-controller",
            Self::Gate => "vlaps-gate",
            Self::Learner => "vlaps-learner",
            Self::Recorder => "vlaps-recorder",
        }
    }
}

/// What a reader receives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// The newest message; older ones are dropped. Late joiners get it too.
    Latest,
    /// Every message, up to this many behind. Then the oldest are lost, and the gap in
    /// the sequence numbers shows how many.
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

/// Messages of a service of newest values that the recorder may fall behind: at 1,000 Hz
/// 64 ms.
pub const RECORDED_DEPTH: usize = 64;
/// Bytes of the largest message with that depth. Each publisher reserves such a queue for
/// each of its 16 readers: 8.7 MB of observations, but 2 GB of frames.
const RECORDED_BYTES_MAX: usize = 16 << 10;

/// The processes from which a reader takes messages of a service.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TakenFrom {
    /// From the process that the run has started as the row's producer.
    Producer,
    /// Every process of the user: offers and requests, which change nothing until their
    /// content is checked.
    Anyone,
}

/// How often a message is published.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rate {
    /// At each tick of this process; the configuration sets its rate.
    Tick(Process),
    /// At this rate, Hz.
    Hz(f64),
    /// On this event.
    Event(&'static str),
}

/// The configuration key beyond which a message is refused as stale.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AgeLimit {
    /// `limits.observation_age_ms`.
    Observation,
    /// `limits.plan_age_ms`.
    Plan,
    /// `limits.command_age_ms`.
    Command,
    /// `limits.takeover_age_ms`.
    Takeover,
    /// No limit: the message carries its own expiry.
    OwnExpiry,
    /// No limit: its content does not age, or its reader shows its age.
    None,
}

impl AgeLimit {
    /// The configuration key; `None` when no key limits the age.
    pub const fn key(self) -> Option<&'static str> {
        match self {
            Self::Observation => Some("limits.observation_age_ms"),
            Self::Plan => Some("limits.plan_age_ms"),
            Self::Command => Some("limits.command_age_ms"),
            Self::Takeover => Some("limits.takeover_age_ms"),
            Self::OwnExpiry | Self::None => None,
        }
    }
}

/// Whether a recording contains the messages of a service.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Recorded {
    /// Every message.
    Yes,
    /// No message.
    No,
    /// Every message; and each step contains the one that its tick used.
    InStep,
}

/// The clock of a message's times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Times {
    /// The run's, which is simulated in lockstep.
    Run,
    /// The machine's, in lockstep too.
    Machine,
}

/// Which messages may leave the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Leaves {
    /// None: they belong to the tick, or name processes of this machine.
    No,
    /// The newest; older ones are dropped on the way.
    Newest,
    /// Every message, in order.
    Every,
}

/// The message type of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MessageType {
    /// The type's name, the same in every language.
    pub name: &'static str,
    /// The layout's hash; two programs with different layouts refuse each other.
    pub fingerprint: u64,
    /// Bytes of one message.
    pub bytes: usize,
    /// Its fields.
    pub table: &'static Table,
}

impl MessageType {
    /// Of a message.
    pub const fn of<M: Layout>() -> Self {
        Self {
            name: M::NAME,
            fingerprint: M::FINGERPRINT,
            bytes: size_of::<M>(),
            table: M::TABLE,
        }
    }
}

/// One row of the service table.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// The service's name; that of a family, such as `health`, has `/*` at its end.
    pub name: &'static str,
    /// The names on the wire: one, or one for each process in the order of their codes.
    pub instances: &'static [&'static str],
    /// The content of the messages.
    pub about: &'static str,
    /// Their type.
    pub message: MessageType,
    /// The processes that publish it. More than one of a kind may exist for a moment
    /// while a dead one is replaced.
    pub producers: &'static [Process],
    /// The commands that publish it too.
    pub tools: &'static [&'static str],
    /// The processes that read it. Commands may read every service.
    pub consumers: &'static [Process],
    /// The consumers that a message wakes.
    pub wakes: &'static [Process],
    /// What a reader receives.
    pub delivery: Delivery,
    /// The processes from which a reader takes it.
    pub taken_from: TakenFrom,
    /// When it is published.
    pub rate: Rate,
    /// The age beyond which a reader refuses it.
    pub age_limit: AgeLimit,
    /// Whether a recording contains it.
    pub recorded: Recorded,
    /// The clock of its messages.
    pub times: Times,
    /// Which messages may leave the machine.
    pub leaves: Leaves,
}

impl Row {
    /// Whether the process publishes it.
    pub const fn is_produced_by(&self, process: Process) -> bool {
        holds(self.producers, process)
    }

    /// Whether the process reads it. The recorder reads each row that is recorded.
    pub const fn is_consumed_by(&self, process: Process) -> bool {
        match process {
            Process::Recorder => !matches!(self.recorded, Recorded::No),
            _ => holds(self.consumers, process),
        }
    }

    /// How many messages the recorder may fall behind. Beside it a reader of the newest
    /// value still has room for one.
    pub const fn recorded_depth(&self) -> usize {
        match self.delivery {
            Delivery::Queue(depth) => depth,
            Delivery::Latest if matches!(self.recorded, Recorded::No) => 1,
            Delivery::Latest if self.message.bytes > RECORDED_BYTES_MAX => 1,
            Delivery::Latest => RECORDED_DEPTH,
        }
    }

    /// Whether the processes that a message wakes are among those that read it.
    pub(super) const fn wakes_readers_only(&self) -> bool {
        let mut k = 0;
        while k < self.wakes.len() {
            if !self.is_consumed_by(self.wakes[k]) {
                return false;
            }
            k += 1;
        }
        true
    }
}

const fn holds(processes: &[Process], process: Process) -> bool {
    let mut k = 0;
    while k < processes.len() {
        if processes[k].code() == process.code() {
            return true;
        }
        k += 1;
    }
    false
}

/// A service with the type of its messages.
#[derive(Debug, Clone, Copy)]
pub struct Service<M> {
    /// The name on the wire.
    pub name: &'static str,
    /// The producer from which readers take it, where [`TakenFrom`] asks.
    pub from: Process,
    /// Its row in the table.
    pub row: Row,
    message: PhantomData<fn() -> M>,
}

impl<M: Layout> Service<M> {
    /// The one service of a row.
    pub(super) const fn of(row: Row) -> Self {
        let from = match row.producers {
            [first, ..] => *first,
            // Only commands publish it, and it is taken from any process.
            [] => Process::Supervisor,
        };
        Self {
            name: row.instances[0],
            from,
            row,
            message: PhantomData,
        }
    }

    /// The service of one process, of a family such as `health/*`.
    pub const fn instance(self, process: Process) -> Self {
        self.of_process(process)
    }

    /// The service of one process, of a family.
    pub(crate) const fn of_process(self, process: Process) -> Self {
        Self {
            name: self.row.instances[process.code() as usize],
            from: process,
            ..self
        }
    }

    /// A service outside the table, for tests.
    pub const fn custom(
        name: &'static str,
        from: Process,
        wakes: &'static [Process],
        delivery: Delivery,
    ) -> Self {
        let row = Row {
            name,
            instances: &[],
            about: "",
            message: MessageType::of::<M>(),
            producers: &[],
            tools: &[],
            consumers: wakes,
            wakes,
            delivery,
            taken_from: TakenFrom::Producer,
            rate: Rate::Event("test"),
            age_limit: AgeLimit::None,
            recorded: Recorded::No,
            times: Times::Run,
            leaves: Leaves::No,
        };
        Self {
            name,
            from,
            row,
            message: PhantomData,
        }
    }
}
