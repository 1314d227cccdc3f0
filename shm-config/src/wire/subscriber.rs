//! The reading end of a service.

use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::PortFactory;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory as Topic;

use super::{Ipc, PUBLISHERS_MAX};
use crate::message::{Header, Message};

type Port<M> = iceoryx2::port::subscriber::Subscriber<Ipc, M, ()>;

/// Reads one service.
pub struct Subscriber<M: Message> {
    port: Port<M>,
    topic: Topic<Ipc, M, ()>,
    /// At the last tending at most one message could wait.
    holds_one: bool,
    depth: usize,
    producer: u32,
    sequence: u64,
    lost: u64,
}

impl<M: Message> Subscriber<M> {
    /// Over an open port of that topic, with a queue of that length.
    pub(super) fn new(port: Port<M>, topic: Topic<Ipc, M, ()>, depth: usize) -> Self {
        Self {
            port,
            topic,
            holds_one: false,
            depth,
            producer: 0,
            sequence: 0,
            lost: 0,
        }
    }

    /// The next message of the queue, not yet admitted; `None` when there is none.
    pub fn receive(&mut self) -> Option<M> {
        let sample = self.port.receive().ok()??;
        self.count(sample.payload().header());
        Some(*sample.payload())
    }

    /// Notes what was overwritten between the last message and this one.
    fn count(&mut self, header: &Header) {
        let (producer, sequence) = (header.producer, header.sequence);
        if producer == self.producer {
            self.lost += sequence.saturating_sub(self.sequence + 1);
        }
        (self.producer, self.sequence) = (producer, sequence);
    }

    /// Looks at the next message of the queue where it lies, not yet admitted;
    /// for messages too large for a stack. `None` when there is none.
    pub fn visit<R>(&mut self, look: impl FnOnce(&M) -> R) -> Option<R> {
        let sample = self.port.receive().ok()??;
        Some(look(sample.payload()))
    }

    /// The newest message since the last look, not yet admitted; `None` when
    /// nothing new came. Two publishers exist while a dead one is replaced, so
    /// this reads until there is nothing left, unless the last [`tend`](Self::tend)
    /// found one publisher and room for one message, and it is the publisher of the
    /// last message who speaks: a second look costs as much as the first, and who came
    /// since then is heard at the next. Of several messages one that makes no sense
    /// hides none that does.
    pub fn newest(&mut self) -> Option<M> {
        let mut newest = None;
        self.newest_into(&mut newest);
        newest
    }

    /// The same over what is kept, which stays when nothing new came; returns
    /// whether something did. Copied once, to where it is used: a step has 4.9 kB.
    pub fn newest_into(&mut self, kept: &mut Option<M>) -> bool {
        let mut came = false;
        // Bounded: a hostile publisher cannot hold a tick.
        for _ in 0..PUBLISHERS_MAX {
            let Ok(Some(sample)) = self.port.receive() else {
                break;
            };
            let message = sample.payload();
            let is_expected = message.header().producer == self.producer;
            self.count(message.header());
            if !came || message.check().is_ok() {
                *kept = Some(*message);
                came = true;
            }
            if self.holds_one && is_expected {
                break;
            }
        }
        came
    }

    /// Messages that were overwritten before they were read.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Connects to publishers that came since the last look, and counts them. To be
    /// called between ticks, so that no tick pays for it.
    pub fn tend(&mut self) {
        // A failure here shows again at the next receive.
        let _ = self.port.update_connections();
        let publishers = self.topic.dynamic_config().number_of_publishers();
        self.holds_one = self.depth * publishers <= 1;
    }
}
