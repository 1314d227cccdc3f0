//! The messages of the protocol.

use recorder::Channel;
use serde::{Deserialize, Serialize};

/// The protocols that are spoken, the preferred one first.
pub const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// The opcode of message data.
const MESSAGE_DATA: u8 = 1;

/// What the server tells as text.
#[derive(Debug, Serialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub(super) enum Told<'a> {
    /// The first message.
    #[serde(rename_all = "camelCase")]
    ServerInfo {
        name: &'a str,
        /// None: clients can change nothing.
        capabilities: [&'a str; 0],
        supported_encodings: [&'a str; 0],
        session_id: &'a str,
    },
    /// The topics.
    Advertise { channels: Vec<Advertised<'a>> },
    /// A line for the user; level 0 is information, 1 a warning, 2 an error.
    Status { level: u8, message: String },
}

/// One topic.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Advertised<'a> {
    id: usize,
    topic: String,
    encoding: &'a str,
    schema_name: &'a str,
    schema: &'a str,
    schema_encoding: &'a str,
}

/// What a client asks. Requests that change something are refused by having no variant.
#[derive(Debug, Deserialize, PartialEq, Eq)]
#[serde(tag = "op", rename_all = "camelCase")]
pub(super) enum Asked {
    /// Messages of these topics from now on.
    Subscribe { subscriptions: Vec<Subscription> },
    /// No more of them.
    #[serde(rename_all = "camelCase")]
    Unsubscribe { subscription_ids: Vec<u32> },
}

/// A number of the client's for a topic.
#[derive(Debug, Deserialize, PartialEq, Eq, Clone, Copy)]
#[serde(rename_all = "camelCase")]
pub(super) struct Subscription {
    pub(super) id: u32,
    pub(super) channel_id: usize,
}

/// The topics as they are advertised; the id is the place.
pub(super) fn advertise(channels: &[Channel]) -> Told<'_> {
    let advertised = channels.iter().enumerate().map(|(id, channel)| Advertised {
        id,
        topic: channel.topic(),
        encoding: "cdr",
        schema_name: &channel.schema,
        schema: &channel.definition,
        schema_encoding: "ros2msg",
    });
    Told::Advertise {
        channels: advertised.collect(),
    }
}

/// A message in binary: opcode, the client's number of the topic, time, CDR.
pub(super) fn message_data(subscription: u32, epoch_ns: u64, cdr: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(13 + cdr.len());
    bytes.push(MESSAGE_DATA);
    bytes.extend_from_slice(&subscription.to_le_bytes());
    bytes.extend_from_slice(&epoch_ns.to_le_bytes());
    bytes.extend_from_slice(cdr);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_messages_are_those_of_the_specification() {
        let info = Told::ServerInfo {
            name: "vlaps",
            capabilities: [],
            supported_encodings: [],
            session_id: "7",
        };
        let text = serde_json::to_string(&info).expect("JSON");
        let expected = r#"{"op":"serverInfo","name":"vlaps","capabilities":[],"supportedEncodings":[],"sessionId":"7"}"#;
        assert_eq!(text, expected);
        let asked = r#"{"op":"subscribe","subscriptions":[{"id":3,"channelId":1}]}"#;
        let subscription = Subscription {
            id: 3,
            channel_id: 1,
        };
        let subscriptions = vec![subscription];
        let read: Asked = serde_json::from_str(asked).expect("a request");
        assert_eq!(read, Asked::Subscribe { subscriptions });
        let asked = r#"{"op":"unsubscribe","subscriptionIds":[3]}"#;
        let read: Asked = serde_json::from_str(asked).expect("a request");
        let subscription_ids = vec![3];
        assert_eq!(read, Asked::Unsubscribe { subscription_ids });
        let changing = r#"{"op":"setParameters","parameters":[]}"#;
        assert!(serde_json::from_str::<Asked>(changing).is_err());
        assert_eq!(
            message_data(3, 258, &[9]),
            [1, 3, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0, 9]
        );
    }
}
