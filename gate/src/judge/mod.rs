//! The judges: exact geometry, a model, recorded answers.

mod faulty;
mod frames;
mod recorded;
mod rules;
mod vlm;

use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, channel};

use shm_config::Instant;
use shm_config::config::{Config, GateMode};

pub use faulty::FaultyJudge;
pub use recorded::Recorded;
pub use rules::Rules;

use crate::model::AskerError;
use crate::query::{Immediate, QueryQueue};
use crate::record::Evidence;
use crate::record::store::{ReadError, read};

/// The configured judge, and the source of evidence for its record.
pub struct OpenJudge {
    /// The queue that takes questions.
    pub queue: Box<dyn QueryQueue>,
    /// What a model was shown and answered.
    pub evidence: Receiver<Evidence>,
}

/// Why the configured judge cannot be asked.
#[derive(Debug, thiserror::Error)]
pub enum JudgeError {
    /// A model cannot be asked.
    #[error(transparent)]
    Asker(#[from] AskerError),
    /// The recording cannot be read.
    #[error("gate.recording: {0}")]
    Recording(#[from] ReadError),
}

impl OpenJudge {
    /// The judge of the configured mode, with the configured faults.
    ///
    /// # Errors
    /// When the model's key is missing, or the recording cannot be read.
    pub fn new(config: &Config, clock: fn() -> Instant) -> Result<Self, JudgeError> {
        let (sender, evidence) = channel();
        let queue = open(config, sender, clock)?;
        let queue = match config.faulty_judge.is_active() {
            true => Box::new(FaultyJudge::new(&config.faulty_judge, queue)),
            false => queue,
        };
        Ok(Self { queue, evidence })
    }
}

fn open(
    config: &Config,
    evidence: Sender<Evidence>,
    clock: fn() -> Instant,
) -> Result<Box<dyn QueryQueue>, JudgeError> {
    Ok(match config.gate.mode {
        GateMode::Vlm | GateMode::Paper => Box::new(vlm::open(config, evidence, clock)?),
        GateMode::Replay => Box::new(recorded(Path::new(&config.gate.recording))?),
        // All of these but `rules` run without a gate process.
        GateMode::Rules
        | GateMode::Expert
        | GateMode::Policy
        | GateMode::Human
        | GateMode::Takeover => Box::new(Immediate::new(Rules::new(config.vehicle, config.safety))),
    })
}

fn recorded(folder: &Path) -> Result<Recorded, ReadError> {
    let records = read(folder)?;
    if records.is_torn {
        tracing::warn!("the recording's last line is incomplete and is left out");
    }
    let last = records.questions.last();
    tracing::info!(
        answers = records.questions.len(),
        last_tick = last.map_or(0, |record| record.tick),
        "replaying recorded answers; after the last one the expert drives"
    );
    Ok(Recorded::new(&records.questions))
}
