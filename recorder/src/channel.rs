//! The channels of a recording: one for each service.

use std::collections::BTreeMap;

use shm_config::services::{Recorded, Row, SERVICES};

use crate::schema;

/// The key of the layout's hash in a channel's metadata.
pub(crate) const LAYOUT_KEY: &str = "layout";
/// The key of the service's name in a channel's metadata.
pub(crate) const SERVICE_KEY: &str = "service";
/// The key in the metadata of a channel that is for viewers alone: made from the messages of
/// services, whose names are the value.
pub(crate) const MADE_FROM_KEY: &str = "made_from";
/// The encoding of the schemas.
pub(crate) const SCHEMA_ENCODING: &str = "ros2msg";
/// The encoding of the messages.
pub(crate) const MESSAGE_ENCODING: &str = "cdr";

/// One channel: the messages of one service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// The service, such as `step` or `health/world`; in the file the topic has a `/` before
    /// it.
    pub service: String,
    /// The name of the message's schema, such as `vlaps_msgs/msg/Step`.
    pub schema: String,
    /// Its definition, in the format `ros2msg`.
    pub definition: String,
    /// The hash of the message's layout, in hexadecimal; empty for a standard topic, which
    /// is no service.
    pub layout: String,
}

impl Channel {
    /// The channel of one instance of a row.
    pub fn of(row: &Row, instance: &str) -> Self {
        Self {
            service: instance.into(),
            schema: schema::name(row.message.table),
            definition: schema::definition(row.message.table),
            layout: format!("{:016x}", row.message.fingerprint),
        }
    }

    /// The channel of a service; `None` when the table has none of this name.
    pub fn named(service: &str) -> Option<Self> {
        let row = SERVICES
            .iter()
            .find(|row| row.instances.contains(&service))?;
        Some(Self::of(row, service))
    }

    /// The channels of all services that a run records, in the order of the service table.
    pub fn recorded() -> Vec<Self> {
        let rows = SERVICES.iter().filter(|row| row.recorded != Recorded::No);
        rows.flat_map(|row| instances(row).map(|instance| Self::of(row, instance)))
            .collect()
    }

    /// The topic in the file.
    pub fn topic(&self) -> String {
        format!("/{}", self.service)
    }

    /// What the file says beside the schema.
    pub(crate) fn metadata(&self) -> BTreeMap<String, String> {
        if self.layout.is_empty() {
            return [(MADE_FROM_KEY.into(), "step, health/*, frame".into())].into();
        }
        let pair = |key: &str, value: &String| (key.to_string(), value.clone());
        [
            pair(SERVICE_KEY, &self.service),
            pair(LAYOUT_KEY, &self.layout),
        ]
        .into()
    }
}

/// The names of a row on the wire: those of a family that a process publishes.
pub(crate) fn instances(row: &Row) -> impl Iterator<Item = &'static str> {
    let is_family = row.instances.len() > 1;
    let producers = row.producers.iter().map(|process| process.code() as usize);
    let of_family = producers.filter(move |_| is_family);
    let alone = (!is_family).then_some(0);
    let instances = row.instances;
    of_family
        .chain(alone)
        .filter_map(|place| instances.get(place).copied())
}
