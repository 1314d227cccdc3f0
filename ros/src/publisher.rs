//! A ROS topic that is published.

use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;

use crate::names::{End, Endpoint, TopicType, attachment};
use crate::session::{Link, first};

/// Publishes messages that are CDR already.
pub struct RosPublisher {
    publisher: Publisher<'static>,
    endpoint: Endpoint,
    sequence: i64,
    _token: LivelinessToken,
}

impl RosPublisher {
    /// Declares it and shows it to others.
    ///
    /// # Errors
    /// When the name or the type is none, or the session is closed.
    pub fn declare(link: &mut Link, topic: &str, of: &TopicType) -> Result<Self, String> {
        let endpoint = link.node.endpoint(topic, of, End::Publisher)?;
        let publisher = link
            .session
            .declare_publisher(endpoint.key.clone())
            // A reader that is too slow loses messages: nothing waits for one.
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map_err(|error| first(&error))?;
        Ok(Self {
            publisher,
            _token: link.show(&endpoint)?,
            endpoint,
            sequence: 0,
        })
    }

    /// Whether anything reads it.
    pub fn is_wanted(&self) -> bool {
        let status = self.publisher.matching_status().wait();
        status.is_ok_and(|status| status.matching())
    }

    /// Sends a message; returns whether the session took it.
    pub fn put(&mut self, epoch_ns: u64, cdr: &[u8]) -> bool {
        self.sequence += 1;
        let attachment = attachment(self.sequence, epoch_ns, self.endpoint.gid);
        let put = self.publisher.put(cdr).attachment(attachment.as_slice());
        put.wait().is_ok()
    }
}
