//! A recording of the recorder, as replay reads it.

use std::path::Path;

use anyhow::{Context, bail};
use recorder::{Entries, Recording};
use shm_config::config::{Config, from_toml};
use shm_config::layout::Layout;
use shm_config::message::{Header, Weights};
use shm_config::services::{
    ADVICE, COMMAND, EPISODE, LEARNING, OBSERVATION, PLAN, PROGRESS, STEP, TAKEOVER, WEIGHTS,
};

use super::learning::Offers;
use super::messages::{AnyMessage, Messages};
use super::source::{Offer, PolicyBytes, Source};

/// The services that replay reads.
const SERVICES: [&str; 9] = [
    OBSERVATION.name,
    PLAN.name,
    COMMAND.name,
    ADVICE.name,
    TAKEOVER.name,
    STEP.name,
    PROGRESS.name,
    EPISODE.name,
    LEARNING.name,
];

/// A recording on disk.
pub struct Recorded {
    recording: Recording,
    config: Config,
    entries: Entries,
}

impl Recorded {
    /// Opens a recording's folder or file.
    ///
    /// # Errors
    /// When it cannot be read, was made with other message layouts, or lacks its
    /// configuration.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        let recording = Recording::open(path)?;
        // Asked for once, so that another layout is told here and not read as no message.
        recording.messages(&OBSERVATION)?;
        recording.messages(&PLAN)?;
        recording.messages(&COMMAND)?;
        recording.messages(&ADVICE)?;
        recording.messages(&TAKEOVER)?;
        recording.messages(&STEP)?;
        recording.messages(&PROGRESS)?;
        recording.messages(&EPISODE)?;
        recording.messages(&LEARNING)?;
        let Some(text) = recording.configuration()? else {
            bail!(
                "{}: the recording has no configuration, so nothing can be recomputed",
                path.display()
            );
        };
        let origin = format!("{}: config.toml", path.display());
        let config = from_toml(&text, &origin)?;
        let entries = recording.entries_of(SERVICES);
        Ok(Self {
            recording,
            config,
            entries,
        })
    }

    /// One line for each file that ends before its end, and for each service of which messages
    /// were lost.
    pub fn damage(&self) -> Vec<String> {
        let lost = self.recording.lost();
        let lost = lost.map(|(service, counts)| format!("lost messages of {service}: {counts}"));
        self.recording
            .damage()
            .map(String::from)
            .chain(lost)
            .collect()
    }

    /// Compares the checksums of the files.
    ///
    /// # Errors
    /// The first file with a bit that is not the one that was written.
    pub fn verify(&self) -> anyhow::Result<()> {
        Ok(self.recording.verify()?)
    }

    /// The file of a message that was taken then, on the run's clock.
    pub fn file_at(&self, taken_ns: u64) -> Option<&Path> {
        self.recording.file_at(taken_ns)
    }

    /// The configuration as it ran, TOML.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn configuration(&self) -> anyhow::Result<String> {
        let text = self.recording.configuration()?;
        text.context("the recording has no configuration")
    }
}

impl Source for Recorded {
    fn config(&self) -> &Config {
        &self.config
    }

    fn policy(&mut self, hash: u64) -> anyhow::Result<Option<PolicyBytes>> {
        let bytes = self.recording.policy(hash)?;
        Ok(bytes.map(|bytes| PolicyBytes { hash, bytes }))
    }

    fn next(&mut self) -> anyhow::Result<Option<AnyMessage>> {
        for entry in self.entries.by_ref() {
            let entry = entry?;
            let message = (entry.read(&STEP).map(AnyMessage::Step))
                .or_else(|| entry.read(&OBSERVATION).map(AnyMessage::Observation))
                .or_else(|| entry.read(&PLAN).map(AnyMessage::Plan))
                .or_else(|| entry.read(&COMMAND).map(AnyMessage::Command))
                .or_else(|| entry.read(&ADVICE).map(AnyMessage::Advice))
                .or_else(|| entry.read(&TAKEOVER).map(AnyMessage::Takeover))
                .or_else(|| entry.read(&PROGRESS).map(AnyMessage::Progress))
                .or_else(|| entry.read(&EPISODE).map(AnyMessage::Episode))
                .or_else(|| entry.read(&LEARNING).map(AnyMessage::Learning));
            if message.is_some() {
                return Ok(message);
            }
        }
        Ok(None)
    }

    /// From the memory of the entry to that of the stretch, without a copy between them.
    fn next_into(&mut self, messages: &mut Messages) -> anyhow::Result<bool> {
        for entry in self.entries.by_ref() {
            let entry = entry?;
            let memory = entry.bytes();
            // Another layout was refused when the recording was opened.
            let is_there = match &entry.channel.service[..] {
                name if name == STEP.name => messages.steps.push_bytes(memory),
                name if name == OBSERVATION.name => messages.observations.push_bytes(memory),
                name if name == PLAN.name => messages.plans.push_bytes(memory),
                name if name == COMMAND.name => messages.commands.push_bytes(memory),
                name if name == ADVICE.name => messages.advice.push_bytes(memory),
                name if name == TAKEOVER.name => messages.takeovers.push_bytes(memory),
                name if name == PROGRESS.name => messages.progress.push_bytes(memory),
                name if name == EPISODE.name => messages.episodes.push_bytes(memory),
                name if name == LEARNING.name => messages.learning.push_bytes(memory),
                _ => false,
            };
            if is_there {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn offers(&self) -> Offers {
        let entries = self.recording.entries_of([WEIGHTS.name]);
        let offers = entries.map(|entry| match entry {
            Ok(entry) => offer(entry.bytes()).context("an offer of weights"),
            Err(error) => Err(error.into()),
        });
        Box::new(offers)
    }

    fn span_ns(&self) -> Option<(u64, u64)> {
        self.recording.span_ns()
    }
}

/// An offer from its message's memory, which is too large for the stack.
fn offer(memory: &[u8]) -> Option<Offer> {
    let field = |name: &str| {
        let field = Weights::FIELDS.iter().find(|field| field.name == name)?;
        memory.get(field.offset..field.offset + field.size)
    };
    let count = u64::from_le_bytes(field("byte_count")?.try_into().ok()?);
    Some(Offer {
        header: Header::from_bytes(field("header")?)?,
        sha256: field("sha256")?.try_into().ok()?,
        file: field("bytes")?.get(..count as usize)?.to_vec(),
    })
}
