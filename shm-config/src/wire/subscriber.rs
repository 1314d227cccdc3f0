//! The reading end of a service.

use std::rc::Rc;

use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::PortFactory;
use iceoryx2::sample::Sample;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory as Topic;

use super::producers::Producers;
use super::{Ipc, PUBLISHERS_MAX};
use crate::message::{Header, Message, Newest, Refusal, RefusalKind};
use crate::services::{Process, Service, TakenFrom};

type Port<M> = iceoryx2::port::subscriber::Subscriber<Ipc, M, ()>;

/// Messages of foreign processes that one read skips, so that a flood on a queue cannot
/// block the reader.
const FOREIGN_MAX: usize = 64;

/// Reads one service.
///
/// A process of a run takes messages only from the process that the run has started
/// as the service's producer; others are refused, counted, and never seen here.
pub struct Subscriber<M: Message> {
    port: Port<M>,
    topic: Topic<Ipc, M, ()>,
    producers: Rc<Producers>,
    from: (Process, TakenFrom),
    /// The process and the membership that sent the last message taken.
    membership: Option<(u32, u128)>,
    /// At the last update of the connections, at most one message could be waiting.
    holds_one: bool,
    depth: usize,
    producer: u32,
    sequence: u64,
    lost: u64,
    /// Whether its process only reads, and waits after each port.
    is_beside: bool,
}

impl<M: Message> Drop for Subscriber<M> {
    fn drop(&mut self) {
        if self.is_beside {
            super::pause();
        }
    }
}

impl<M: Message> Subscriber<M> {
    /// A subscriber on an open port of this topic, with a queue of this length.
    pub(super) fn new(
        port: Port<M>,
        topic: Topic<Ipc, M, ()>,
        producers: Rc<Producers>,
        (service, depth): (Service<M>, usize),
        is_beside: bool,
    ) -> Self {
        Self {
            port,
            topic,
            producers,
            from: (service.from, service.row.taken_from),
            membership: None,
            holds_one: false,
            depth,
            producer: 0,
            sequence: 0,
            lost: 0,
            is_beside,
        }
    }

    /// The next message of the queue that is from a known producer.
    fn next(&mut self) -> Option<Sample<Ipc, M, ()>> {
        for _ in 0..FOREIGN_MAX {
            let sample = self.port.receive().ok()??;
            if self.producers.admits(sample.header(), self.from) {
                self.producers
                    .compare(sample.header(), self.from, &mut self.membership);
                self.count(sample.payload().header());
                return Some(sample);
            }
            self.producers.count(RefusalKind::Foreign);
        }
        None
    }

    /// The next message of the queue, not yet admitted; `None` when there is none.
    pub fn receive(&mut self) -> Option<M> {
        self.next().map(|sample| *sample.payload())
    }

    /// Counts the messages that were overwritten between the last message and this one.
    fn count(&mut self, header: &Header) {
        let (producer, sequence) = (header.producer, header.sequence);
        if producer == self.producer {
            // The numbers of a message that is not admitted yet may be anything.
            let lost = sequence.saturating_sub(self.sequence.saturating_add(1));
            self.lost = self.lost.saturating_add(lost);
        }
        (self.producer, self.sequence) = (producer, sequence);
    }

    /// Reads the next message of the queue in place, not yet admitted;
    /// for messages too large for a stack. `None` when there is none.
    pub fn visit<R>(&mut self, look: impl FnOnce(&M) -> R) -> Option<R> {
        self.next().map(|sample| look(sample.payload()))
    }

    /// The newest admissible message since the last read; `None` when none arrived.
    ///
    /// `admit` is the caller's check: content, age, episode, instant on the grid. It
    /// runs before the newest message is chosen, so a refused message never masks an
    /// admissible one. Refusals are counted by reason ([`Wire::refused`]).
    ///
    /// Two publishers exist while a dead one is replaced, so this drains the queue.
    /// With one publisher connected at the last
    /// [`update_connections`](Self::update_connections), room for one message, and the
    /// message from that publisher, one read is enough.
    ///
    /// [`Wire::refused`]: super::Wire::refused
    pub fn newest(&mut self, admit: impl FnMut(&M) -> Result<(), Refusal>) -> Option<M> {
        let mut newest = None;
        self.read(admit, |message| newest = Some(*message));
        newest
    }

    /// As [`Subscriber::newest`], into `kept`, which stays unchanged when no admissible
    /// message arrived; returns whether one did.
    pub fn newest_into(
        &mut self,
        kept: &mut Newest<M>,
        admit: impl FnMut(&M) -> Result<(), Refusal>,
    ) -> bool {
        let mut came = false;
        self.read(admit, |message| {
            kept.keep(message);
            came = true;
        });
        came
    }

    /// Gives each admissible message since the last read, the newest last.
    fn read(&mut self, mut admit: impl FnMut(&M) -> Result<(), Refusal>, mut give: impl FnMut(&M)) {
        // The number of reads is limited, so that a hostile publisher cannot block a
        // tick.
        for _ in 0..PUBLISHERS_MAX {
            let last = self.producer;
            let Some(sample) = self.next() else {
                break;
            };
            let message = sample.payload();
            let is_expected = message.header().producer == last;
            match admit(message) {
                Ok(()) => give(message),
                Err(refusal) => self.producers.count(refusal.kind()),
            }
            if self.holds_one && is_expected {
                break;
            }
        }
    }

    /// Messages that were overwritten before they were read.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Connects to publishers that came since the last call, and counts them. To be
    /// called between ticks, so that no tick pays for it.
    pub fn update_connections(&mut self) {
        // A failure here appears again at the next receive.
        let _ = self.port.update_connections();
        let publishers = self.topic.dynamic_config().number_of_publishers();
        self.holds_one = self.depth * publishers <= 1;
    }
}
