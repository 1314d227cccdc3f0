//! Names of rmw_zenoh: key expressions of topics, liveliness tokens, attachments.
//!
//! A message on `DOMAIN/topic/package::msg::dds_::Name_/RIHS01_...` is CDR with an attachment
//! of 33 bytes. A token on `@ros2_lv/...` shows a node or an endpoint to `ros2 topic list` and
//! the like. Source: docs/design.md of <https://github.com/ros2/rmw_zenoh>.

use recorder::Channel;
use xxhash_rust::xxh3::xxh3_128;
use zenoh::key_expr::KeyExpr;
use zenoh::session::ZenohId;

use crate::type_hash::rihs01;

/// Bytes of an attachment: two numbers, the length of the identity, and the identity.
pub const ATTACHMENT_BYTES: usize = 8 + 8 + 1 + GID_BYTES;
/// Bytes of a publisher's identity.
const GID_BYTES: usize = 16;
/// Messages that a subscriber may fall behind, as `ros2 topic info` shows it.
const DEPTH: usize = 10;

/// The type of a topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicType {
    /// Such as `nav_msgs/msg/Path`.
    pub name: String,
    /// Such as `RIHS01_...`.
    pub hash: String,
}

impl TopicType {
    /// The type of a channel.
    ///
    /// # Errors
    /// When its definition is not understood.
    pub fn of(channel: &Channel) -> Result<Self, String> {
        Self::new(&channel.schema, &channel.definition)
    }

    /// A type with its definition in the format `ros2msg`.
    ///
    /// # Errors
    /// When the definition is not understood.
    pub fn new(name: &str, definition: &str) -> Result<Self, String> {
        Ok(Self {
            name: name.into(),
            hash: rihs01(name, definition)?,
        })
    }

    /// A standard type, such as `nav_msgs/Path`.
    ///
    /// # Errors
    /// When the recorder's list does not have it.
    pub fn standard(short: &str) -> Result<Self, String> {
        let name = short.replacen('/', "/msg/", 1);
        Self::new(&name, &recorder::standard::definition(short))
    }

    /// Its name in DDS, such as `nav_msgs::msg::dds_::Path_`.
    pub fn dds_name(&self) -> String {
        match self.name.rsplit_once('/') {
            Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
            None => format!("dds_::{}_", self.name),
        }
    }
}

/// Which end of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// It publishes.
    Publisher,
    /// It reads what comes from now on.
    Subscription,
    /// It also asks for what was published before it.
    LateSubscription,
}

/// A node of ROS in one session.
#[derive(Debug, Clone)]
pub struct Node {
    domain: usize,
    session: ZenohId,
    name: String,
    next: usize,
}

/// One end of a topic, as others see it.
#[derive(Debug, Clone, PartialEq)]
pub struct Endpoint {
    /// Where its messages are.
    pub key: KeyExpr<'static>,
    /// Where its token is.
    pub token: KeyExpr<'static>,
    /// Its identity in attachments.
    pub gid: [u8; GID_BYTES],
}

impl Node {
    /// A node of this name in a domain.
    pub fn new(domain: usize, session: ZenohId, name: &str) -> Self {
        Self {
            domain,
            session,
            name: name.into(),
            // The node has the number 0.
            next: 1,
        }
    }

    /// Where its token is.
    ///
    /// # Errors
    /// When its name is none.
    pub fn token(&self) -> Result<KeyExpr<'static>, String> {
        self.token_of((0, "NN"), "")
    }

    /// The token of the node or of an end of it; `%` stands for no enclave and no namespace.
    fn token_of(&self, (id, kind): (usize, &str), more: &str) -> Result<KeyExpr<'static>, String> {
        let (domain, session, name) = (self.domain, self.session, &self.name);
        let token = format!("@ros2_lv/{domain}/{session}/0/{id}/{kind}/%/%/{name}{more}");
        KeyExpr::try_from(token).map_err(|error| error.to_string())
    }

    /// Another end of a topic.
    ///
    /// # Errors
    /// When the topic's name is none.
    pub fn endpoint(&mut self, topic: &str, of: &TopicType, end: End) -> Result<Endpoint, String> {
        let kind = match end {
            End::Publisher => "MP",
            End::Subscription | End::LateSubscription => "MS",
        };
        // A quality that is rmw_zenoh's default is left out; 1 is transient local.
        let durability = match end {
            End::LateSubscription => "1",
            End::Publisher | End::Subscription => "",
        };
        let quality = format!(":{durability}:,{DEPTH}:,:,:,,");
        let (dds_name, hash) = (of.dds_name(), &of.hash);
        let mangled = topic.replace('/', "%");
        let more = format!("/{mangled}/{dds_name}/{hash}/{quality}");
        let token = self.token_of((self.next, kind), &more)?;
        self.next += 1;
        let (domain, plain) = (self.domain, topic.trim_matches('/'));
        let key = KeyExpr::try_from(format!("{domain}/{plain}/{dds_name}/{hash}"));
        Ok(Endpoint {
            key: key.map_err(|error| format!("{topic}: {error}"))?,
            gid: xxh3_128(token.as_bytes()).to_le_bytes(),
            token,
        })
    }
}

/// What goes with a message: its number from 1 on, when it was published, and by which
/// publisher.
pub fn attachment(sequence: i64, epoch_ns: u64, gid: [u8; GID_BYTES]) -> [u8; ATTACHMENT_BYTES] {
    let mut bytes = [0; ATTACHMENT_BYTES];
    bytes[..8].copy_from_slice(&sequence.to_le_bytes());
    let epoch_ns = i64::try_from(epoch_ns).unwrap_or(i64::MAX);
    bytes[8..16].copy_from_slice(&epoch_ns.to_le_bytes());
    bytes[16] = GID_BYTES as u8;
    bytes[17..].copy_from_slice(&gid);
    bytes
}

/// Type and hash at the end of a topic's key; `None` for a key of another form.
pub fn type_of_key(key: &str) -> Option<(&str, &str)> {
    let mut chunks = key.rsplit('/');
    let (hash, name) = (chunks.next()?, chunks.next()?);
    chunks.next().is_some().then_some((name, hash))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn string() -> TopicType {
        TopicType::new("std_msgs/msg/String", "string data\n").expect("a type")
    }

    /// The forms that rmw_zenoh's design document shows.
    #[test]
    fn keys_and_tokens_have_the_form_of_rmw_zenoh() {
        let session: ZenohId = "8b20917502ee955ac4476e0266340d5c".parse().expect("an id");
        let mut node = Node::new(0, session, "talker");
        let hash = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        let own = "@ros2_lv/0/8b20917502ee955ac4476e0266340d5c/0";
        assert_eq!(
            node.token().expect("a token").as_str(),
            format!("{own}/0/NN/%/%/talker")
        );
        let end = node.endpoint("/robot/chatter", &string(), End::Publisher);
        let end = end.expect("an endpoint");
        assert_eq!(
            end.key.as_str(),
            format!("0/robot/chatter/std_msgs::msg::dds_::String_/{hash}")
        );
        assert_eq!(
            end.token.as_str(),
            format!(
                "{own}/1/MP/%/%/talker/%robot%chatter/std_msgs::msg::dds_::String_/{hash}/\
                 ::,10:,:,:,,"
            )
        );
        let late = node.endpoint("/tf_static", &string(), End::LateSubscription);
        let late = late.expect("an endpoint");
        assert!(late.token.contains("/2/MS/"), "{}", late.token);
        assert!(late.token.ends_with("/:1:,10:,:,:,,"), "{}", late.token);
        assert_ne!(late.gid, end.gid);
        assert_eq!(
            type_of_key(&end.key),
            Some(("std_msgs::msg::dds_::String_", hash))
        );
        assert_eq!(type_of_key("a/b"), None);
        assert_eq!(type_of_key(""), None);
    }

    #[test]
    fn an_attachment_is_two_numbers_and_an_identity_with_its_length() {
        let bytes = attachment(1, 0x0102, [7; GID_BYTES]);
        assert_eq!(bytes[..8], [1, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(bytes[8..16], [2, 1, 0, 0, 0, 0, 0, 0]);
        assert_eq!((bytes[16], &bytes[17..]), (16, &[7; GID_BYTES][..]));
    }

    #[test]
    fn every_recorded_row_and_standard_topic_has_a_type() {
        use recorder::standard::Topic;
        let channels = Channel::recorded().into_iter();
        let channels = channels.chain(Topic::ALL.map(Topic::channel));
        for channel in channels {
            let of = TopicType::of(&channel).expect("a type");
            assert_eq!(of.hash.len(), 71, "{}", of.hash);
        }
        let drive = TopicType::standard("ackermann_msgs/AckermannDriveStamped");
        assert_eq!(
            drive.expect("a type").dds_name(),
            "ackermann_msgs::msg::dds_::AckermannDriveStamped_"
        );
        assert!(TopicType::standard("nowhere/Nothing").is_err());
    }
}
