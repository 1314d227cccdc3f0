//! The judges: exact geometry, a model, a distilled net, recorded answers.

mod distilled;
mod faulty;
mod frames;
mod lookout;
mod recorded;
mod rules;
mod vlm;

use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, channel};

use shm_config::Instant;
use shm_config::config::{Config, GateMode, PassTo};

pub use distilled::{Distilled, agree};
pub use faulty::FaultyJudge;
pub use recorded::Recorded;
pub use rules::Rules;

use lookout::{Foreseen, Lookout};

use crate::distilled::{DistilledNet, FileError, read as read_net};
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
    /// The file of the distilled judge cannot be used.
    #[error("gate.distilled: {0}")]
    Net(#[from] FileError),
    /// The distilled judge was taught by answers to another prompt.
    #[error(
        "gate.distilled: {file}: it has learned answers to the prompt {theirs}, vlm.prompt is \
         {ours}; distil the answers to this prompt, or set vlm.prompt=\"{theirs}\""
    )]
    Prompt {
        /// The file.
        file: String,
        /// Its preset.
        theirs: String,
        /// The configured one.
        ours: &'static str,
    },
}

impl OpenJudge {
    /// The judge of the configured mode, with the configured faults.
    ///
    /// # Errors
    /// When the model's key is missing, or a recording or a distilled judge cannot be read.
    pub fn new(config: &Config, clock: fn() -> Instant) -> Result<Self, JudgeError> {
        let (sender, evidence) = channel();
        let queue = open(config, &sender, clock)?;
        Ok(Self { queue, evidence })
    }
}

fn open(
    config: &Config,
    evidence: &Sender<Evidence>,
    clock: fn() -> Instant,
) -> Result<Box<dyn QueryQueue>, JudgeError> {
    let lookout = || Lookout::start(config, evidence.clone(), clock);
    Ok(match config.gate.mode {
        GateMode::Vlm | GateMode::Paper => model(config, evidence, clock)?,
        GateMode::Replay => faulty(
            config,
            Box::new(recorded(Path::new(&config.gate.recording))?),
        ),
        GateMode::Distilled => {
            let net = net(config)?;
            let slow = match config.gate.pass_to {
                PassTo::Vlm => model(config, evidence, clock)?,
                PassTo::Rules => rules(config),
            };
            let audit = config.gate.audit;
            let reports = (evidence.clone(), clock);
            let judge = Distilled::new((net, config.vehicle), slow, audit, reports);
            match config.gate.foresight {
                true => Box::new(judge.with_lookout(lookout())),
                false => Box::new(judge),
            }
        }
        // All of these but `rules` run without a gate process.
        GateMode::Rules
        | GateMode::Expert
        | GateMode::Policy
        | GateMode::Human
        | GateMode::Takeover => match config.gate.foresight {
            true => Box::new(Foreseen::new(rules(config), lookout())),
            false => rules(config),
        },
    })
}

fn rules(config: &Config) -> Box<dyn QueryQueue> {
    let rules = Rules::new(config.vehicle, config.safety);
    faulty(config, Box::new(Immediate::new(rules)))
}

fn model(
    config: &Config,
    evidence: &Sender<Evidence>,
    clock: fn() -> Instant,
) -> Result<Box<dyn QueryQueue>, JudgeError> {
    let model = vlm::open(config, evidence.clone(), clock)?;
    Ok(faulty(config, Box::new(model)))
}

/// The queue with the configured faults. Behind a distilled judge they are those of the
/// slow one.
fn faulty(config: &Config, queue: Box<dyn QueryQueue>) -> Box<dyn QueryQueue> {
    match config.faulty_judge.is_active() {
        true => Box::new(FaultyJudge::new(&config.faulty_judge, queue)),
        false => queue,
    }
}

/// The net of `gate.distilled`. A net that has learned from a model has to be in front of
/// a model that is asked with the same prompt.
fn net(config: &Config) -> Result<DistilledNet, JudgeError> {
    let file = &config.gate.distilled;
    let net = read_net(Path::new(file))?;
    let about = &net.about;
    let ours = config.vlm.prompt.word();
    let has_prompt = config.gate.pass_to == PassTo::Vlm && !about.preset.is_empty();
    if has_prompt && about.preset != ours {
        return Err(JudgeError::Prompt {
            file: file.clone(),
            theirs: about.preset.clone(),
            ours,
        });
    }
    tracing::info!(
        teacher = about.teacher,
        learned = about.learned,
        questions = about.questions,
        threshold = about.threshold,
        "a distilled judge answers first"
    );
    Ok(net)
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
