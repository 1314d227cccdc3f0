//! Where a recorded run comes from.

use std::path::Path;

use anyhow::Context;
use recorder::{CONFIGURATION, Origin, POLICIES, Writer};
use shm_config::config::Config;
use shm_config::message::Header;
use shm_config::services::{
    ADVICE, COMMAND, EPISODE, LEARNING, OBSERVATION, PLAN, PROGRESS, STEP, TAKEOVER,
};

use super::learning::Offers;
use super::messages::{AnyMessage, Messages};
use crate::report::hex;

/// A policy file of the run.
#[derive(Clone, Debug)]
pub struct PolicyBytes {
    /// First 8 bytes of its SHA-256, as steps name it.
    pub hash: u64,
    /// The file.
    pub bytes: Vec<u8>,
}

/// Weights that were offered to the controller.
#[derive(Clone, Debug)]
pub struct Offer {
    /// The message's header.
    pub header: Header,
    /// The SHA-256 that the message names.
    pub sha256: [u8; 32],
    /// The policy file.
    pub file: Vec<u8>,
}

/// A recorded run, read in order.
pub trait Source: Send {
    /// The configuration as it ran.
    fn config(&self) -> &Config;

    /// The policy file of these weights; `None` when the recording does not have it.
    ///
    /// # Errors
    /// When it cannot be read.
    fn policy(&mut self, hash: u64) -> anyhow::Result<Option<PolicyBytes>>;

    /// The next message; `None` after the last.
    ///
    /// # Errors
    /// When the recording cannot be read.
    fn next(&mut self) -> anyhow::Result<Option<AnyMessage>>;

    /// Adds the next message to those of a stretch; whether there was one.
    ///
    /// # Errors
    /// As [`Source::next`].
    fn next_into(&mut self, messages: &mut Messages) -> anyhow::Result<bool> {
        let message = self.next()?;
        Ok(message.map(|message| messages.push(message)).is_some())
    }

    /// The weights that were offered, from the run's beginning on.
    fn offers(&self) -> Offers;

    /// Time from the first to the last message, ns, where the recording says it: for the
    /// bar.
    fn span_ns(&self) -> Option<(u64, u64)> {
        None
    }
}

/// Messages of a stretch: 4,096 ticks of all processes at equal rates, 50 MB.
const STRETCH: usize = 4096 * 5;

/// The next stretch of a run, in the memory of an earlier one; empty after the last.
///
/// # Errors
/// When the recording cannot be read.
pub fn next_stretch(source: &mut dyn Source, mut messages: Messages) -> anyhow::Result<Messages> {
    messages.clear();
    while messages.len() < STRETCH && source.next_into(&mut messages)? {}
    Ok(messages)
}

/// A run in memory.
#[derive(Clone, Debug)]
pub struct InMemory {
    /// Its configuration.
    pub config: Config,
    /// Its policies.
    pub policies: Vec<PolicyBytes>,
    /// The weights that were offered.
    pub offers: Vec<Offer>,
    /// Its messages in order.
    pub messages: Vec<AnyMessage>,
    /// The next one that is read.
    pub at: usize,
}

impl InMemory {
    /// A run of these messages.
    pub fn new(config: Config, messages: Vec<AnyMessage>) -> Self {
        Self {
            config,
            policies: Vec::new(),
            offers: Vec::new(),
            messages,
            at: 0,
        }
    }

    /// Writes the run, without its offers, to a file as the recorder does.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn save(&self, path: &Path) -> anyhow::Result<()> {
        let origin = Origin {
            run: "rehearsed".into(),
            session: "1".into(),
            ..Origin::default()
        };
        let mut writer = Writer::create(path, &origin)?;
        let text = toml::to_string(&self.config).context("the configuration")?;
        writer.attach(CONFIGURATION, "application/toml", text.as_bytes())?;
        for policy in &self.policies {
            let name = format!("{POLICIES}{}", hex(&policy::sha256(&policy.bytes)));
            writer.attach(&name, "application/octet-stream", &policy.bytes)?;
        }
        for message in &self.messages {
            match message {
                AnyMessage::Observation(m) => writer.write(&OBSERVATION, m.header.taken_ns, m),
                AnyMessage::Plan(m) => writer.write(&PLAN, m.header.taken_ns, m),
                AnyMessage::Command(m) => writer.write(&COMMAND, m.header.taken_ns, m),
                AnyMessage::Advice(m) => writer.write(&ADVICE, m.header.taken_ns, m),
                AnyMessage::Takeover(m) => writer.write(&TAKEOVER, m.header.taken_ns, m),
                AnyMessage::Step(m) => writer.write(&STEP, m.header.taken_ns, m),
                AnyMessage::Progress(m) => writer.write(&PROGRESS, m.header.taken_ns, m),
                AnyMessage::Episode(m) => writer.write(&EPISODE, m.header.taken_ns, m),
                AnyMessage::Learning(m) => writer.write(&LEARNING, m.header.taken_ns, m),
            }?;
        }
        writer.finish()?;
        Ok(())
    }
}

impl Source for InMemory {
    fn config(&self) -> &Config {
        &self.config
    }

    fn policy(&mut self, hash: u64) -> anyhow::Result<Option<PolicyBytes>> {
        let found = self.policies.iter().find(|policy| policy.hash == hash);
        Ok(found.cloned())
    }

    fn next(&mut self) -> anyhow::Result<Option<AnyMessage>> {
        let message = self.messages.get(self.at).copied();
        self.at += 1;
        Ok(message)
    }

    fn offers(&self) -> Offers {
        Box::new(self.offers.clone().into_iter().map(Ok))
    }
}
