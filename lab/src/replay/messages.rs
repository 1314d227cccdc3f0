//! The messages of a stretch of a recorded run, found by their sender's number.

use std::collections::HashMap;

use shm_config::message::{
    Advice, Command, Episode, Header, Learning, Message, Observation, Plan, Progress, Step,
    Takeover,
};

/// One recorded message that replay reads.
#[derive(Clone, Copy, Debug)]
#[allow(clippy::large_enum_variant)] // it is handed on, not kept
pub enum AnyMessage {
    /// Of the world.
    Observation(Observation),
    /// Of the planner.
    Plan(Plan),
    /// Of the controller.
    Command(Command),
    /// Of the gate.
    Advice(Advice),
    /// Of the person at the keys.
    Takeover(Takeover),
    /// Of the controller: one tick.
    Step(Step),
    /// Of the world: how far the episode is.
    Progress(Progress),
    /// Of the world: an episode's end.
    Episode(Episode),
    /// Of the learner: the step that it considered last.
    Learning(Learning),
}

/// What a message is found by: the process that sent it, and its number there.
pub type Key = (u32, u64);

/// The key of a message.
pub fn key(header: &Header) -> Key {
    (header.producer, header.sequence)
}

/// Messages of one service in the order in which they were recorded.
#[derive(Clone, Debug)]
pub struct Channel<M> {
    /// All of them.
    pub all: Vec<M>,
    by_key: HashMap<Key, usize>,
    by_time: HashMap<Taken, usize>,
    /// The least and the largest number of each sender.
    numbers: HashMap<u32, (u64, u64)>,
}

impl<M> Default for Channel<M> {
    fn default() -> Self {
        Self {
            all: Vec::new(),
            by_key: HashMap::new(),
            by_time: HashMap::new(),
            numbers: HashMap::new(),
        }
    }
}

impl<M: Message> Channel<M> {
    /// Adds the next message.
    pub fn push(&mut self, message: M) {
        let (producer, sequence) = key(message.header());
        self.by_key.insert((producer, sequence), self.all.len());
        self.by_time.insert(taken(message.header()), self.all.len());
        let (least, most) = self.numbers.entry(producer).or_insert((sequence, sequence));
        (*least, *most) = ((*least).min(sequence), (*most).max(sequence));
        self.all.push(message);
    }

    /// Adds the next message from its memory; whether that is as long as a message.
    pub fn push_bytes(&mut self, memory: &[u8]) -> bool {
        let message = M::from_bytes(memory);
        message.map(|message| self.push(message)).is_some()
    }

    /// Forgets all messages and keeps the memory for the next.
    fn clear(&mut self) {
        self.all.clear();
        self.by_key.clear();
        self.by_time.clear();
        self.numbers.clear();
    }

    /// The message of this key.
    pub fn find(&self, key: Key) -> Option<&M> {
        self.by_key.get(&key).map(|&index| &self.all[index])
    }

    /// The last message taken then.
    pub fn at(&self, at: Taken) -> Option<&M> {
        self.by_time.get(&at).map(|&index| &self.all[index])
    }

    /// The least and the largest number of a sender's messages.
    pub fn numbers(&self, producer: u32) -> Option<(u64, u64)> {
        self.numbers.get(&producer).copied()
    }
}

/// What identifies an observation in a plan, or a step in advice: episode, tick, and when
/// it was taken.
pub type Taken = (u32, u64, u64);

/// Episode, tick and instant of a message.
pub fn taken(header: &Header) -> Taken {
    (header.episode, header.tick, header.taken_ns)
}

/// The messages of one stretch of a run.
#[derive(Clone, Debug, Default)]
pub struct Messages {
    /// What the world published.
    pub observations: Channel<Observation>,
    /// What the planner answered.
    pub plans: Channel<Plan>,
    /// What the controller sent to the world.
    pub commands: Channel<Command>,
    /// What the gate published.
    pub advice: Channel<Advice>,
    /// What the person's keys said.
    pub takeovers: Channel<Takeover>,
    /// The ticks of the controller.
    pub steps: Channel<Step>,
    /// How far the episode was.
    pub progress: Channel<Progress>,
    /// Finished episodes.
    pub episodes: Channel<Episode>,
    /// What the learner told.
    pub learning: Channel<Learning>,
}

impl Messages {
    /// Adds the next message of the run.
    pub fn push(&mut self, message: AnyMessage) {
        match message {
            AnyMessage::Observation(message) => self.observations.push(message),
            AnyMessage::Plan(message) => self.plans.push(message),
            AnyMessage::Command(message) => self.commands.push(message),
            AnyMessage::Advice(message) => self.advice.push(message),
            AnyMessage::Takeover(message) => self.takeovers.push(message),
            AnyMessage::Step(message) => self.steps.push(message),
            AnyMessage::Progress(message) => self.progress.push(message),
            AnyMessage::Episode(message) => self.episodes.push(message),
            AnyMessage::Learning(message) => self.learning.push(message),
        }
    }

    /// Forgets all messages and keeps the memory for the next: a stretch has 190 MB, and new
    /// memory for each would cost a tenth of a replay.
    pub fn clear(&mut self) {
        self.observations.clear();
        self.plans.clear();
        self.commands.clear();
        self.advice.clear();
        self.takeovers.clear();
        self.steps.clear();
        self.progress.clear();
        self.episodes.clear();
        self.learning.clear();
    }

    /// How many messages the processes that are recomputed sent.
    pub fn len(&self) -> usize {
        self.observations.all.len()
            + self.plans.all.len()
            + self.commands.all.len()
            + self.advice.all.len()
            + self.takeovers.all.len()
            + self.steps.all.len()
    }

    /// Whether none of them is there.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A stretch between the one before and the one after it, in which a message's origin or
/// copy may lie.
pub struct Stretch<'a> {
    /// Its own messages.
    pub now: &'a Messages,
    /// Those before and after it.
    pub beside: [&'a Messages; 2],
    /// Its number, from 0.
    pub number: u64,
}

impl<'a> Stretch<'a> {
    fn everywhere(&self) -> [&'a Messages; 3] {
        let [before, after] = self.beside;
        [self.now, before, after]
    }

    /// What is found in the stretch itself, else before or after it.
    pub fn find<T: ?Sized>(&self, find: impl Fn(&'a Messages) -> Option<&'a T>) -> Option<&'a T> {
        self.everywhere().into_iter().find_map(find)
    }
}
