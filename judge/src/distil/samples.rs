//! Recorded questions as numbers to learn from.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use gate::distilled::{INPUTS, Side, party_features};
use gate::presentation::Party;
use gate::query::Question;
use gate::record::store::{Records, read};
use gate::record::{Proposed, Record, Said};
use shm_config::config::{Config, load};
use shm_config::draw::Draw;
use shm_config::message::{Assessment, Proposal};
use vehicle::Action;

use crate::audit::Truth;

/// An accident that comes later by less than this is not safer, s: two ticks.
const LATER_S: f64 = 0.2;

/// The answers that count as right in training: expert, policy, similar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Label(pub [bool; 3]);

impl Label {
    const EXPERT: Self = Self([true, false, false]);
    const POLICY: Self = Self([false, true, false]);
    const SIMILAR: Self = Self([false, false, true]);
    /// The policy may drive, because it is safer or as safe.
    const NOT_EXPERT: Self = Self([false, true, true]);

    /// The driver that would drive.
    pub fn driver(self) -> Party {
        match self == Self::EXPERT {
            true => Party::Expert,
            false => Party::Policy,
        }
    }

    /// A wrong answer in place of this one, as `faulty_judge.noise` makes it.
    fn inverted(self) -> Self {
        match self == Self::EXPERT {
            true => Self::POLICY,
            false => Self::EXPERT,
        }
    }
}

/// What a net learns from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Learn {
    /// The judge's answers.
    Answers,
    /// The judge's answers, corrected where the simulator knows which path is safer.
    Outcomes,
}

impl Learn {
    /// The word on the command line and in the file.
    pub fn word(self) -> &'static str {
        match self {
            Self::Answers => "answers",
            Self::Outcomes => "outcomes",
        }
    }
}

/// One question.
#[derive(Debug, Clone)]
pub struct Sample {
    /// The features of the expert's and the policy's proposal.
    pub seen: [[f32; INPUTS]; 2],
    /// Those of the mirrored scene.
    pub mirrored: [[f32; INPUTS]; 2],
    /// The judge's answer; `None` if it gave none.
    pub answer: Option<Label>,
    /// What really happens, by the simulator.
    pub truth: Truth,
    /// The answer that the simulator decides; `None` where it decides nothing.
    outcome: Option<Label>,
    /// Identifies the map, or the episode where the map is unknown: all questions of one
    /// are on the same side of a split.
    pub group: u64,
}

impl Sample {
    /// What is right, after the answer was made wrong for a share of the samples.
    pub fn label(&self, learn: Learn) -> Option<Label> {
        match learn {
            Learn::Answers => self.answer,
            Learn::Outcomes => self.outcome.or(self.answer),
        }
    }

    /// The safer driver, where exactly one path ends in an accident.
    pub fn safer(&self) -> Option<Party> {
        match self.truth {
            Truth::Safer(party) => Some(party),
            Truth::BothSafe | Truth::NeitherSafe | Truth::Unknown => None,
        }
    }
}

/// The questions of several runs.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    /// The questions, in the order of the runs and in each in the order of asking.
    pub samples: Vec<Sample>,
    /// Runs.
    pub runs: usize,
    /// Questions without features: a proposal is missing, or the scanner is another.
    pub unfit: usize,
    /// Whose answers these are.
    pub teacher: Teacher,
    /// What they cost.
    pub asked: Asked,
    /// Folders whose configuration is unknown: the default car is taken.
    pub unconfigured: Vec<PathBuf>,
}

/// Whose answers were recorded.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct Teacher {
    /// What kind of judge, a word of `shm_config::message::Judge`.
    pub judge: String,
    /// Its prompt preset; empty for a judge without a prompt.
    pub preset: String,
    /// The model that was asked; empty for none.
    pub model: String,
}

/// What the recorded answers cost.
#[derive(Debug, Clone, Default)]
pub struct Asked {
    /// Questions.
    pub questions: usize,
    /// Time driven, on the runs' clocks, s.
    pub driven_s: f64,
    /// Tokens in and out.
    pub tokens: [u64; 2],
    /// Cost as it was recorded, US dollars.
    pub cost_usd: f64,
    /// Latency of each answer, s.
    pub latencies_s: Vec<f64>,
}

impl Samples {
    /// Reads the records of these folders.
    ///
    /// # Errors
    /// If a folder has no records, a record is of a format without the observation, or
    /// the records are of judges with different prompts.
    pub fn read(folders: &[PathBuf]) -> anyhow::Result<Self> {
        let mut all = Self::default();
        for folder in folders {
            let records = read(folder)?;
            let config = configuration(&records.folder)?;
            if config.is_none() {
                all.unconfigured.push(folder.clone());
            }
            all.add(&records, config.as_ref())?;
        }
        if all.samples.is_empty() {
            bail!(
                "{}: no question that a net can learn from: each needs two proposals, and the scan \
                 of 240 beams that policies are trained with",
                folders
                    .first()
                    .map_or("".into(), |folder| folder.display().to_string())
            );
        }
        Ok(all)
    }

    fn add(&mut self, records: &Records, config: Option<&Config>) -> anyhow::Result<()> {
        let vehicle = config.map(|config| config.vehicle).unwrap_or_default();
        let run = self.runs as u64;
        self.runs += 1;
        for record in &records.questions {
            self.take_teacher(records, record)?;
            self.asked.count(record);
            let question = question(record).with_context(|| {
                format!("{}, question {}", records.folder.display(), record.question)
            })?;
            let rows = |side| party_features(&question, &vehicle, side);
            let (Some(seen), Some(mirrored)) = (rows(Side::Seen), rows(Side::Mirrored)) else {
                self.unfit += 1;
                continue;
            };
            self.samples.push(Sample {
                seen,
                mirrored,
                answer: answer(record),
                truth: Truth::of(record),
                outcome: outcome(record),
                // Two runs may have driven the same map.
                group: match config {
                    Some(config) => config.run.seed.wrapping_add(u64::from(record.episode)),
                    None => (run << 40) | u64::from(record.episode),
                },
            });
        }
        let taken = records.questions.iter().map(|record| record.taken_ns);
        let span_ns = taken.clone().max().unwrap_or(0) - taken.min().unwrap_or(0);
        self.asked.driven_s += span_ns as f64 * 1e-9;
        Ok(())
    }

    fn take_teacher(&mut self, records: &Records, record: &Record) -> anyhow::Result<()> {
        // A question that the end of the run cancelled names no prompt.
        if record.net.is_some() || (record.judge == "vlm" && record.preset.is_empty()) {
            return Ok(());
        }
        let teacher = Teacher {
            judge: record.judge.clone(),
            preset: record.preset.clone(),
            model: record.model.clone(),
        };
        if self.teacher == Teacher::default() {
            self.teacher = teacher;
            return Ok(());
        }
        if self.teacher == teacher {
            return Ok(());
        }
        bail!(
            "{}, question {}: answered by {}, other questions by {}; distil the answers of one judge \
             at a time",
            records.folder.display(),
            record.question,
            teacher.words(),
            self.teacher.words()
        )
    }

    /// Makes a share of the answers wrong. The same seed gives the same wrong answers.
    pub fn spoil(&mut self, noise: f64, seed: u64) {
        let mut draw = Draw::new(seed ^ 0x006e_6f69_7365);
        for sample in &mut self.samples {
            if draw.within(0.0, 1.0) < noise {
                sample.answer = sample.answer.map(Label::inverted);
            }
        }
    }
}

impl Teacher {
    /// The judge in words.
    pub fn words(&self) -> String {
        match (self.model.as_str(), self.preset.as_str()) {
            ("", _) => self.judge.clone(),
            (model, preset) => format!("{} ({model}, prompt {preset})", self.judge),
        }
    }
}

impl Asked {
    fn count(&mut self, record: &Record) {
        self.questions += 1;
        self.cost_usd += record.cost_usd;
        for asking in &record.askings {
            self.tokens[0] += asking.tokens_in;
            self.tokens[1] += asking.tokens_out;
        }
        if record.preference.is_some() && !record.askings.is_empty() {
            self.latencies_s.push(record.latency_s);
        }
    }
}

/// The configuration of the run whose records these are; `None` if it is not beside
/// them.
fn configuration(records: &Path) -> anyhow::Result<Option<Config>> {
    // A replay's answers are in a folder of the records.
    let paths = ["../config.toml", "../../config.toml"].map(|path| records.join(path));
    let path = paths.into_iter().find(|path| path.is_file());
    Ok(path.map(|path| load(&path)).transpose()?)
}

/// The question of a record.
fn question(record: &Record) -> anyhow::Result<Question> {
    let seen = record.observation.as_ref().with_context(|| {
        format!(
            "its record (format {}) has no observation to learn from; record the run again with this \
             build",
            record.version
        )
    })?;
    let observation = seen.observation().map_err(anyhow::Error::msg)?;
    let proposal = |proposed: &Option<Proposed>| {
        Proposal::new(proposed.map(|proposed| Action {
            steer: proposed.steer,
            pedal: proposed.pedal,
        }))
    };
    Ok(Question {
        observation: *observation,
        expert: proposal(&record.expert),
        policy: proposal(&record.policy),
        expert_assessment: Assessment::default(),
        policy_assessment: Assessment::default(),
    })
}

/// The teacher's answer. The answers of a distilled net teach nothing: where one was
/// asked, only the slow judge's counts.
fn answer(record: &Record) -> Option<Label> {
    if let Some(net) = &record.net
        && net.passed_on.is_none()
    {
        return match net.audit.as_deref()? {
            "expert" => Some(Label::EXPERT),
            "policy" => Some(Label::NOT_EXPERT),
            _ => None,
        };
    }
    match record.said() {
        Said::Expert => Some(Label::EXPERT),
        Said::Similar => Some(Label::SIMILAR),
        // Exact geometry has no word for "similar".
        Said::Policy if record.askings.is_empty() => Some(Label::NOT_EXPERT),
        Said::Policy => Some(Label::POLICY),
        Said::Abstained | Said::Failed => None,
    }
}

/// What the simulator decides: which path ends in an accident, or in the later one.
fn outcome(record: &Record) -> Option<Label> {
    let label = |party| match party {
        Party::Expert => Label::EXPERT,
        Party::Policy => Label::POLICY,
    };
    match Truth::of(record) {
        Truth::Safer(party) => Some(label(party)),
        Truth::BothSafe | Truth::Unknown => None,
        Truth::NeitherSafe => {
            let outlooks = record.foresight.as_ref()?;
            let ends = |party: Party| {
                let of = outlooks.iter().find(|outlook| outlook.party == party)?;
                Some(of.contact_s.min(of.out_s))
            };
            let later_s = ends(Party::Expert)? - ends(Party::Policy)?;
            match later_s.abs() >= LATER_S {
                true if later_s > 0.0 => Some(Label::EXPERT),
                true => Some(Label::POLICY),
                false => None,
            }
        }
    }
}

/// The parts of the questions.
#[derive(Debug, Clone, Default)]
pub struct Split {
    /// Indices that the nets learn from.
    pub learn: Vec<usize>,
    /// Indices by which the training ends in time.
    pub stop: Vec<usize>,
    /// Indices for temperature and threshold.
    pub calibrate: Vec<usize>,
}

impl Split {
    /// 70, 10 and 20 of 100 groups, drawn with this seed; all questions of a group are in
    /// the same part.
    ///
    /// # Errors
    /// If there are too few groups for three parts.
    pub fn of(samples: &[Sample], seed: u64) -> anyhow::Result<Self> {
        let mut groups: Vec<u64> = samples.iter().map(|sample| sample.group).collect();
        groups.sort_unstable();
        groups.dedup();
        let count = groups.len();
        if count < 10 {
            bail!(
                "{count} episodes are too few to learn from some and to check with others; record at \
                 least 10, better 100"
            );
        }
        let mut draw = Draw::new(seed ^ 0x0073_706c_6974);
        for at in (1..count).rev() {
            groups.swap(at, draw.below(at as u64 + 1) as usize);
        }
        let (stop, rest) = groups.split_at(count / 10);
        let (calibrate, _) = rest.split_at(count / 5);
        let mut split = Self::default();
        for (index, sample) in samples.iter().enumerate() {
            let part = match &sample.group {
                group if stop.contains(group) => &mut split.stop,
                group if calibrate.contains(group) => &mut split.calibrate,
                _ => &mut split.learn,
            };
            part.push(index);
        }
        Ok(split)
    }
}
