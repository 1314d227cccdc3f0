//! The stack's own ports: numbered, newest first, admitted at the door.

use std::time::Duration;

use anyhow::bail;
use shm_config::Message;
use shm_config::message::{Advice, Command, Observation, Plan, Step};
use shm_config::services::{Delivery, Process, Service};
use shm_config::wire::{Doorbell, Publisher, Subscriber, Wire};

use super::arguments::Wake;
use super::link::{LOST_NS, Link};

/// How long one wait for the bell lasts at most.
const NAP: Duration = Duration::from_millis(500);

/// A message that is measured.
pub trait Measured: Message {
    /// Its name.
    const WORD: &'static str;
    /// From the asking process to the answering one, and back.
    const SERVICES: [&'static str; 2];

    /// As full as in a drive.
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

/// Which end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The process that asks.
    Ping,
    /// The process that answers.
    Echo,
}

impl End {
    /// The processes that the two ends stand for.
    pub fn process(self) -> Process {
        match self {
            Self::Ping => Process::World,
            Self::Echo => Process::Controller,
        }
    }

    /// Places of what it publishes and what it reads.
    pub fn places(self) -> [usize; 2] {
        match self {
            Self::Ping => [0, 1],
            Self::Echo => [1, 0],
        }
    }
}

/// Whether messages are looked at before they are trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Door {
    /// As every reader of the stack does.
    Admit,
    /// For what the door costs.
    Open,
}

/// One end over the stack's ports.
pub struct Port<M: Message> {
    publisher: Publisher<M>,
    subscriber: Subscriber<M>,
    bell: Option<Doorbell>,
    /// The last one received goes back.
    message: Option<M>,
    /// Set between two blocks.
    pub door: Door,
}

impl<M: Measured> Port<M> {
    /// Opens both ports, and the bell of a receiver that sleeps on it.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub fn open(wire: &Wire, end: End, wake: Wake) -> anyhow::Result<Self> {
        let [ours, theirs] = end.places().map(|place| {
            // The reader of this place is woken by what is published in it.
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
            message: Some(M::full()),
            door: Door::Admit,
        })
    }
}

impl<M: Measured> Link for Port<M> {
    fn send(&mut self) -> bool {
        let message = self.message.as_mut();
        message.is_some_and(|message| self.publisher.send(message))
    }

    fn receive(&mut self) -> anyhow::Result<bool> {
        let door = self.door;
        let mut refused = None;
        let came = self.subscriber.newest_into(&mut self.message, |message| {
            if door == Door::Admit {
                // A tick has read its clock before the message comes.
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
            bell.wait(NAP);
        }
    }
}
