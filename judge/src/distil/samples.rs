//! Recorded questions as numbers to learn from.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use gate::distilled::{INPUTS, Side, party_features};
use gate::presentation::Party;
use gate::query::Question;
use gate::record::store::{Records, read};
use gate::record::{Proposed, Record, Said};
use shm_config::config::{Config, load};
use shm_config::draw::Draw;
use shm_config::message::{Assessment, Judge, Proposal};
use vehicle::Action;

use super::split::Group;
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
    /// All questions of a group are on the same side of a split.
    pub group: Group,
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
        let run = self.runs;
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
                group: match config {
                    Some(config) => Group::Map(config.run.episode_seed(record.episode)),
                    None => Group::Episode {
                        run,
                        episode: record.episode,
                    },
                },
            });
        }
        let taken = records.questions.iter().map(|record| record.taken_ns);
        let span_ns = taken.clone().max().unwrap_or(0) - taken.min().unwrap_or(0);
        self.asked.driven_s += span_ns as f64 * 1e-9;
        Ok(())
    }

    fn take_teacher(&mut self, records: &Records, record: &Record) -> anyhow::Result<()> {
        let Some(teacher) = Teacher::of(record) else {
            return Ok(());
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

    /// Checks that figures measured on these questions hold for a net that has learned from
    /// the others: no map is in both, and the same judge has answered. Runs without a
    /// configuration are not compared by map, because theirs is unknown.
    ///
    /// # Errors
    /// Names a map that is in both, or the two judges.
    pub fn check_apart(&self, learned: &Self) -> anyhow::Result<()> {
        let maps = |samples: &[Sample]| -> BTreeSet<u64> {
            let map = |sample: &Sample| match sample.group {
                Group::Map(seed) => Some(seed),
                Group::Episode { .. } => None,
            };
            samples.iter().filter_map(map).collect()
        };
        let [own, theirs] = [&self.samples, &learned.samples].map(|of| maps(of));
        let both: Vec<_> = own.intersection(&theirs).collect();
        if let Some(seed) = both.first() {
            bail!(
                "{} also among the runs to learn from, such as that of seed {seed}; record the runs of \
                 --test on other seeds",
                match both.len() {
                    1 => "1 map of --test is".into(),
                    count => format!("{count} maps of --test are"),
                }
            );
        }
        let is_known = |teacher: &Teacher| *teacher != Teacher::default();
        let [own, theirs] = [&self.teacher, &learned.teacher];
        if own != theirs && is_known(own) && is_known(theirs) {
            bail!(
                "the runs of --test were answered by {}, those to learn from by {}; test with answers \
                 of the same judge",
                own.words(),
                theirs.words()
            );
        }
        Ok(())
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
    /// Whose answer this is; `None` for that of a net, and for a question that the end of the
    /// run cancelled, which names no prompt.
    fn of(record: &Record) -> Option<Self> {
        if record.net.is_some() {
            answer(record)?;
            // The record names the distilled judge; a slow one that answers without being
            // asked a prompt is exact geometry.
            return Some(match record.askings.is_empty() {
                true => Self {
                    judge: Judge::Rules.to_string(),
                    ..Self::default()
                },
                false => Self {
                    judge: Judge::Vlm.to_string(),
                    preset: record.preset.clone(),
                    model: record.model.clone(),
                },
            });
        }
        let is_cancelled = record.judge == "vlm" && record.preset.is_empty();
        (!is_cancelled).then(|| Self {
            judge: record.judge.clone(),
            preset: record.preset.clone(),
            model: record.model.clone(),
        })
    }

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
            // The counts are those of a server.
            let tokens = [asking.tokens_in, asking.tokens_out];
            for (sum, count) in self.tokens.iter_mut().zip(tokens) {
                *sum = sum.saturating_add(count);
            }
        }
        // Beside an audit, the latency is that of the net.
        let is_slow = record
            .net
            .as_ref()
            .is_none_or(|net| net.passed_on.is_some());
        if is_slow && record.preference.is_some() && !record.askings.is_empty() {
            self.latencies_s.push(record.latency_s);
        }
    }
}

/// The configuration of the run whose records these are; `None` if it is not beside
/// them.
fn configuration(records: &Path) -> anyhow::Result<Option<Config>> {
    // A replay's answers are in a folder of the records.
    let places = [
        (Some(records), records.join("../config.toml")),
        (records.parent(), records.join("../../config.toml")),
    ];
    let beside = places.into_iter().find(|(_, path)| path.is_file());
    let Some((of, path)) = beside else {
        return Ok(None);
    };
    // The file beside the records of an earlier run is that of the later one.
    if of.and_then(Path::file_name) == Some("judge-before".as_ref()) {
        return Ok(None);
    }
    Ok(Some(load(&path)?))
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
