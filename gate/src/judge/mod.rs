//! The judges: exact geometry, a model, recorded answers.

mod faulty;
mod recorded;
mod rules;
mod worker;

use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, channel};

use shm_config::Instant;
use shm_config::config::{Config, GateMode, Juror, PromptPreset, Rollout, When};

pub use faulty::Flaws;
pub use recorded::Recorded;
pub use rules::Rules;
pub use worker::model;

use crate::model::AskerError;
use crate::query::{AtOnce, Committee, Docket};
use crate::record::Evidence;
use crate::record::store::{ReadError, read};

/// Who sits in judgment, and what they leave for the record.
pub struct Bench {
    /// Where questions go.
    pub docket: Box<dyn Docket>,
    /// What models saw and said.
    pub evidence: Receiver<Evidence>,
}

/// Why nobody can judge.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// A model cannot be asked.
    #[error(transparent)]
    Asker(#[from] AskerError),
    /// The recording cannot be read.
    #[error("gate.recording: {0}")]
    Recording(#[from] ReadError),
}

impl Bench {
    /// The judges of the configured mode.
    ///
    /// # Errors
    /// When the model's key, or the recording, cannot be had.
    pub fn open(config: &Config, clock: fn() -> Instant) -> Result<Self, BenchError> {
        let (sender, evidence) = channel();
        let gate = &config.gate;
        let docket: Box<dyn Docket> = match gate.mode {
            GateMode::Vlm | GateMode::Paper => Box::new(model(config, sender, clock)?),
            GateMode::Committee => {
                let jurors = gate
                    .committee
                    .iter()
                    .map(|juror| seat(*juror, config, &sender, clock))
                    .collect::<Result<_, _>>()?;
                let (quorum, capacity) = (gate.quorum as usize, gate.in_flight as usize);
                Box::new(Committee::new(jurors, quorum, capacity))
            }
            GateMode::Replay => {
                let records = read(Path::new(&gate.recording))?;
                if records.is_torn {
                    tracing::warn!("the recording's last line is torn and left out");
                }
                let last = records.questions.last();
                tracing::info!(
                    answers = records.questions.len(),
                    last_tick = last.map_or(0, |record| record.tick),
                    "recorded answers; after the last the expert drives"
                );
                Box::new(Recorded::new(&records.questions))
            }
            // Of the last three nobody starts a gate.
            GateMode::Rules | GateMode::Expert | GateMode::Policy | GateMode::Human => {
                Box::new(rules(config))
            }
        };
        Ok(Self { docket, evidence })
    }
}

fn seat(
    juror: Juror,
    config: &Config,
    evidence: &Sender<Evidence>,
    clock: fn() -> Instant,
) -> Result<Box<dyn Docket>, AskerError> {
    Ok(match juror {
        Juror::Rules => Box::new(rules(config)),
        Juror::Vlm => Box::new(model(config, evidence.clone(), clock)?),
    })
}

fn rules(config: &Config) -> AtOnce<Rules> {
    AtOnce::new(Rules::new(config.vehicle, config.judge))
}

/// What `--gate paper` is: asked every `T_vlm` and once, told who is who, shown
/// one step of 1.5 s, and obeyed at once (Sec. 4.2 and 8.5).
pub fn as_the_paper(mut config: Config) -> Config {
    if config.gate.mode != GateMode::Paper {
        return config;
    }
    config.gate.when = When::Period;
    config.gate.dwell_s = 0.0;
    config.gate.confirmations = 1;
    config.vlm.ask_twice = false;
    config.vlm.rollout = Rollout::Paper;
    config.vlm.horizon_s = 1.5;
    if config.vlm.prompt == PromptPreset::Blind {
        config.vlm.prompt = PromptPreset::Paper;
    }
    config
}
