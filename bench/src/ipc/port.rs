//! Connection through the stack's ports: numbered, newest first, checked on receipt.

use std::time::Duration;

use anyhow::bail;
use shm_config::Message;
use shm_config::message::{Advice, Command, Newest, Observation, Plan, Step};
use shm_config::services::{Delivery, Process, Service};
use shm_config::wire::{Doorbell, Publisher, Subscriber, Wire};

use super::arguments::Wake;
use super::link::{LOST_NS, Link};

/// Time limit of one wait for the doorbell.
const WAIT_MAX: Duration = Duration::from_millis(500);

/// A message type that is measured.
pub trait Measured: Message {
    /// Name on the command line.
    const WORD: &'static str;
    /// Services from the asking process to the answering one, and back.
    const SERVICES: [&'static str; 2];

    /// A message as full as in a drive.
    fn full() -> Self;
}

macro_rules! measured {
    ($message:ident, $name:literal, $full:expr) => {
        impl Measured for $message {
            const WORD: &'static str = $name;
            const SERVICES: [&'static str; 2] = [concat!("there-", $name), concat!("back-", $name)];
            fn full() -> Self {
                $full
            }
        }
    };
}

measured!(
    Observation,
    "observation",
    Observation {
        beam_count: 240,
        ..Observation::default()
    }
);
measured!(
    Plan,
    "plan",
    Plan {
        waypoint_count: 20,
        ..Plan::default()
    }
);
measured!(Command, "command", Step::default().command);
measured!(
    Step,
    "step",
    Step {
        observation: Observation::full(),
        plan: Plan::full(),
        ..Step::default()
    }
);
measured!(Advice, "advice", Advice::default());

/// The end of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// In the asking process.
    Ping,
    /// In the answering process.
    Echo,
}

impl End {
    /// The stack's process whose place it takes.
    pub fn process(self) -> Process {
        match self {
            Self::Ping => Process::World,
            Self::Echo => Process::Controller,
        }
    }

    /// Slot numbers of what it publishes and what it reads.
    pub fn places(self) -> [usize; 2] {
        match self {
            Self::Ping => [0, 1],
            Self::Echo => [1, 0],
        }
    }
}

/// Whether received messages are checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Check {
    /// As by every reader of the stack.
    Admit,
    /// Not checked, to measure the cost of the check.
    Skip,
}

/// One end of a connection through the stack's ports.
pub struct Port<M: Message> {
    publisher: Publisher<M>,
    subscriber: Subscriber<M>,
    bell: Option<Doorbell>,
    /// The last received message, which is sent back.
    message: Newest<M>,
    /// Changed between two blocks.
    pub check: Check,
}

impl<M: Measured> Port<M> {
    /// Opens both ports, and the doorbell of a receiver that sleeps.
    ///
    /// # Errors
    /// If shared memory refuses.
    pub fn open(wire: &Wire, end: End, wake: Wake) -> anyhow::Result<Self> {
        let [ours, theirs] = end.places().map(|place| {
            // Publishing at this place wakes its reader.
            let woken: &'static [Process] = match (wake, place) {
                (Wake::Spin | Wake::Grid, _) => &[],
                (Wake::Bell, 0) => &[Process::Controller],
                (Wake::Bell, _) => &[Process::World],
            };
            let from = [End::Ping, End::Echo][place].process();
            Service::<M>::custom(M::SERVICES[place], from, woken, Delivery::Latest)
        });
        Ok(Self {
            publisher: wire.publisher(ours)?,
            subscriber: wire.subscriber(theirs)?,
            bell: match wake {
                Wake::Bell => Some(wire.doorbell(end.process())?),
                Wake::Spin | Wake::Grid => None,
            },
            message: Newest::from(M::full()),
            check: Check::Admit,
        })
    }
}

impl<M: Measured> Link for Port<M> {
    fn send(&mut self) -> bool {
        let message = self.message.get_mut();
        message.is_some_and(|message| self.publisher.send(message))
    }

    fn receive(&mut self) -> anyhow::Result<bool> {
        let check = self.check;
        let mut refused = None;
        let came = self.subscriber.newest_into(&mut self.message, |message| {
            if check == Check::Admit {
                // As in a tick, the clock is read before the message is received.
                let admitted = message.admit(message.header().taken(), LOST_NS);
                refused = admitted.err();
                return admitted;
            }
            Ok(())
        });
        match refused {
            Some(refusal) => bail!("{}: {refusal}", M::WORD),
            None => Ok(came),
        }
    }

    fn update_connections(&mut self) {
        self.publisher.update_connections();
        self.subscriber.update_connections();
    }

    fn wait(&self) {
        if let Some(bell) = &self.bell {
            bell.wait(WAIT_MAX);
        }
    }
}
