//! What is kept of every question: one line of JSON, and the pictures beside it.
//!
//! A run's folder holds `judge/questions.jsonl` and `judge/pictures/`.

mod archive;
mod query_log;
pub mod store;
mod tally;
mod word;

use serde::{Deserialize, Serialize};
use shm_config::message::{Assessment, Preference, Proposal};

pub use archive::Archive;
pub use query_log::{Evidence, Filed, QueryLog};

use crate::model::Asked;
use crate::presentation::{Party, Prompt, Reply, Showing};
use crate::query::Occasion;

/// Version of the format; a reader refuses a newer one.
pub const VERSION: u32 = 1;

/// One question and everything that became of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// [`VERSION`].
    pub version: u32,
    /// Counts the questions of a run from 1.
    pub question: u64,
    /// The run's tick.
    pub tick: u64,
    /// The run's episode, from 0.
    pub episode: u32,
    /// When the observation was taken, on the run's clock, ns.
    pub taken_ns: u64,
    /// Why it was asked.
    pub occasion: Occasion,
    /// What kind of judge answered, a word of `shm_config::message::Judge`.
    pub judge: String,
    /// Name of the prompt preset.
    pub preset: String,
    /// Name of the model that was asked for; what a server says it is stands with
    /// each asking.
    pub model: String,
    /// Speed of the car, m/s.
    pub speed_mps: f64,
    /// What the expert proposed; `None` for nothing.
    pub expert: Option<Proposed>,
    /// What the policy proposed; `None` for nothing.
    pub policy: Option<Proposed>,
    /// One asking, or two with the paths swapped.
    pub askings: Vec<Asking>,
    /// The answer, a word: `expert`, `policy`, `abstain`, or `failed` for `None`.
    #[serde(rename = "verdict", with = "word")]
    pub preference: Option<Preference>,
    /// Why there is no preference, for people; empty when there is one.
    pub fault: String,
    /// From question to answer, s of the wall clock.
    pub latency_s: f64,
    /// What all attempts have cost, US dollars.
    pub cost_usd: f64,
    /// When the answer was heard: tick of the run; 0 when it never was.
    pub heard_tick: u64,
    /// When the answer was heard, on the run's clock, ns.
    pub heard_ns: u64,
    /// What the simulator says would have happened; `None` where nobody knows.
    pub foresight: Option<[Outlook; 2]>,
    /// What happened in the 3 s after the question; `None` when the run ended.
    pub aftermath: Option<Aftermath>,
}

impl Record {
    /// What was said.
    pub fn said(&self) -> Said {
        Said::of(self.preference, &self.askings)
    }

    /// Why there is no answer, in one word; `None` where there is one.
    pub fn failure(&self) -> Option<&str> {
        match (self.preference, self.fault.as_str()) {
            (Some(_), _) => None,
            (None, "") => Some("unknown"),
            (None, fault) => Some(fault),
        }
    }
}

/// One proposal, and what the judge in the tick measured of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Proposed {
    /// Steering, normalised.
    pub steer: f64,
    /// Pedal, normalised.
    pub pedal: f64,
    /// Least distance to any lidar return along the rollout, m.
    pub clearance_m: f64,
    /// Time to the first contact or to leaving the road, s.
    pub safe_s: f64,
    /// It was vetoed in the tick.
    pub vetoed: bool,
}

impl Proposed {
    /// A proposal with its assessment; `None` when there is none.
    pub fn new(proposal: &Proposal, assessment: &Assessment) -> Option<Self> {
        proposal.action().map(|action| Self {
            steer: action.steer,
            pedal: action.pedal,
            clearance_m: assessment.clearance_m,
            safe_s: assessment.safe_s,
            vetoed: assessment.is_vetoed(),
        })
    }
}

/// One picture, one prompt, and what came back.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Asking {
    /// How the two paths were shown.
    pub showing: Showing,
    /// File of the picture, relative to the folder of the records; empty when
    /// there was none or the folder was full.
    pub picture: String,
    /// What the model was told.
    pub system: String,
    /// What the model was asked.
    pub user: String,
    /// What it said, as it came, cut to a limit.
    pub said: String,
    /// The model that said it, as the server names it; empty when it does not.
    #[serde(default)]
    pub served: String,
    /// What that was read as.
    pub reply: Option<Reply>,
    /// How sure it said it was, 0 to 1.
    pub confidence: Option<f64>,
    /// Why there is no reply: a word of the closed list of faults.
    pub fault: Option<String>,
    /// HTTP requests made for it.
    pub attempts: u32,
    /// From the first request to the end, s.
    pub latency_s: f64,
    /// Tokens in, as the server counts them.
    pub tokens_in: u64,
    /// Tokens out, as the server counts them.
    pub tokens_out: u64,
    /// What it cost, US dollars.
    pub cost_usd: f64,
}

impl Asking {
    /// What came of a prompt; the picture's file is named where it is kept.
    pub fn new(prompt: &Prompt, asked: &Asked) -> Self {
        Self {
            showing: prompt.showing,
            picture: String::new(),
            system: prompt.system.clone(),
            user: prompt.user.clone(),
            said: asked.said.clone(),
            served: asked.served.clone(),
            reply: asked.reply.ok().map(|(reply, _)| reply),
            confidence: asked.reply.ok().and_then(|(_, confidence)| confidence),
            fault: asked.reply.err().map(|fault| fault.word().into()),
            attempts: asked.attempts,
            latency_s: asked.latency.as_secs_f64(),
            tokens_in: asked.tokens_in,
            tokens_out: asked.tokens_out,
            cost_usd: asked.cost_usd,
        }
    }
}

/// An answer with "similar" told apart: an answer that lets the policy drive, as the
/// paper's 0 does, but prefers neither.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Said {
    /// The expert's path is safer.
    Expert,
    /// The policy's path is safer.
    Policy,
    /// Neither is clearly safer: an answer for the policy, and no preference.
    Similar,
    /// The replies disagree.
    Abstained,
    /// No answer.
    Failed,
}

impl Said {
    /// All of them, in the order of tables.
    pub const ALL: [Self; 5] = [
        Self::Expert,
        Self::Policy,
        Self::Similar,
        Self::Abstained,
        Self::Failed,
    ];

    /// What the answer to these askings says.
    pub fn of(preference: Option<Preference>, askings: &[Asking]) -> Self {
        let is_similar = |asking: &Asking| asking.reply == Some(Reply::Similar);
        match preference {
            Some(Preference::Policy) if !askings.is_empty() && askings.iter().all(is_similar) => {
                Self::Similar
            }
            Some(Preference::Expert) => Self::Expert,
            Some(Preference::Policy) => Self::Policy,
            Some(Preference::Abstain) => Self::Abstained,
            None => Self::Failed,
        }
    }

    /// Whom it prefers.
    pub fn preference(self) -> Option<Party> {
        match self {
            Self::Expert => Some(Party::Expert),
            Self::Policy => Some(Party::Policy),
            Self::Similar | Self::Abstained | Self::Failed => None,
        }
    }

    /// In one word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Expert => "expert",
            Self::Policy => "policy",
            Self::Similar => "similar",
            Self::Abstained => "abstained",
            Self::Failed => "failed",
        }
    }
}

/// What the simulator says would have happened had a proposal been held.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Outlook {
    /// Whose proposal.
    pub party: Party,
    /// Time looked ahead, s.
    pub horizon_s: f64,
    /// Time to the first contact, s; the horizon when there is none.
    pub contact_s: f64,
    /// Time to leaving the road, s; the horizon when it is not left.
    pub out_s: f64,
}

impl Outlook {
    /// It ends in a contact or off the road.
    pub fn is_accident(&self) -> bool {
        self.contact_s < self.horizon_s || self.out_s < self.horizon_s
    }
}

/// What happened after the question, whoever drove.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Aftermath {
    /// Ticks looked at.
    pub ticks: u32,
    /// Ticks the expert drove.
    pub expert: u32,
    /// Ticks the policy drove.
    pub policy: u32,
    /// Ticks the brake drove.
    pub brake: u32,
    /// Ticks in which the judge in the tick vetoed whose turn it was.
    pub vetoed: u32,
    /// Least clearance that the judge in the tick measured of the rollout of
    /// whoever drove, m; of the expert's while the brake did.
    pub clearance_m: f64,
    /// The episode ended meanwhile.
    pub ended: bool,
}
