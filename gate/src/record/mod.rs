//! The record of every question: one line of JSON, and the pictures beside it.
//!
//! A run's folder holds `judge/questions.jsonl` and `judge/pictures/`.

mod archive;
mod net_opinion;
mod query_log;
pub mod store;
mod tally;
mod word;

use serde::{Deserialize, Serialize};
use shm_config::message::{Assessment, Preference, Proposal};
use shm_config::seen::Seen;

pub use archive::Archive;
pub use net_opinion::{NetOpinion, Unsure};
pub use query_log::{Evidence, Filed, QueryLog};

use crate::model::Asked;
use crate::presentation::{Party, Prompt, Reply, Showing};
use crate::query::Occasion;

/// Version of the format; a reader refuses a newer one.
pub const VERSION: u32 = 2;

/// One question, its answer and its aftermath.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// [`VERSION`].
    pub version: u32,
    /// The number of the question in the run, from 1.
    pub question: u64,
    /// The run's tick.
    pub tick: u64,
    /// The run's episode, from 0.
    pub episode: u32,
    /// When the observation was taken, on the run's clock, ns.
    pub taken_ns: u64,
    /// Why the judge was asked.
    pub occasion: Occasion,
    /// What kind of judge answered, a word of `shm_config::message::Judge`.
    pub judge: String,
    /// Name of the prompt preset.
    pub preset: String,
    /// Name of the model that was requested. Each asking holds the name that the server
    /// gave.
    pub model: String,
    /// Speed of the car, m/s.
    pub speed_mps: f64,
    /// What the car saw; `None` in records of format 1.
    #[serde(default)]
    pub observation: Option<Box<Seen>>,
    /// The expert's proposal; `None` if there was none.
    pub expert: Option<Proposed>,
    /// The policy's proposal; `None` if there was none.
    pub policy: Option<Proposed>,
    /// One asking, or two with the paths swapped.
    pub askings: Vec<Asking>,
    /// The answer, a word: `expert`, `policy`, `abstain`, or `failed` for `None`.
    #[serde(rename = "verdict", with = "word")]
    pub preference: Option<Preference>,
    /// Why there is no preference, as text; empty when there is one.
    pub fault: String,
    /// Time from question to answer, s of the wall clock.
    pub latency_s: f64,
    /// What all attempts have cost, US dollars.
    pub cost_usd: f64,
    /// The tick of the run at which the answer was heard; 0 if it was never heard.
    pub heard_tick: u64,
    /// When the answer was heard, on the run's clock, ns.
    pub heard_ns: u64,
    /// What a distilled net thought of the question; `None` where none was asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub net: Option<NetOpinion>,
    /// What the simulator foresaw for both proposals; `None` if it foresaw nothing.
    pub foresight: Option<[Outlook; 2]>,
    /// What happened in the 3 s after the question; `None` when the run ended earlier.
    pub aftermath: Option<Aftermath>,
}

impl Record {
    /// The answer, with "similar" as a case of its own.
    pub fn said(&self) -> Said {
        match &self.net {
            Some(net) if net.passed_on.is_none() => net.said(self.preference),
            _ => Said::of(self.preference, &self.askings),
        }
    }

    /// Why there is no answer, in one word; `None` if there is one.
    pub fn failure(&self) -> Option<&str> {
        match (self.preference, self.fault.as_str()) {
            (Some(_), _) => None,
            (None, "") => Some("unknown"),
            (None, fault) => Some(fault),
        }
    }
}

/// One proposal, and the assessment of the safety check in the tick.
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
    /// The safety check vetoed it.
    pub vetoed: bool,
}

impl Proposed {
    /// A proposal with its assessment; `None` if there is no proposal.
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

/// One picture, one prompt, and the reply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Asking {
    /// How the picture showed the two paths.
    pub showing: Showing,
    /// File of the picture, relative to the folder of the records; empty if there was
    /// no picture or no room.
    pub picture: String,
    /// The system message.
    pub system: String,
    /// The user message.
    pub user: String,
    /// The model's text, cut to a length.
    pub said: String,
    /// The model's name as the server gave it; empty if it gave none.
    #[serde(default)]
    pub served: String,
    /// The reply read from the text.
    pub reply: Option<Reply>,
    /// The model's stated confidence, 0 to 1.
    pub confidence: Option<f64>,
    /// Why there is no reply: a word of the closed list of faults.
    pub fault: Option<String>,
    /// HTTP requests made for this asking.
    pub attempts: u32,
    /// Time from the first request to the end, s.
    pub latency_s: f64,
    /// Tokens in, as the server counts them.
    pub tokens_in: u64,
    /// Tokens out, as the server counts them.
    pub tokens_out: u64,
    /// What it cost, US dollars.
    pub cost_usd: f64,
}

impl Asking {
    /// The result of a prompt; the picture's file is named once it is stored.
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

/// An answer in which "similar" is a case of its own: it lets the policy drive, as the
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

    /// The meaning of the answer to these askings.
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

    /// The party that the answer prefers.
    pub fn preference(self) -> Option<Party> {
        match self {
            Self::Expert => Some(Party::Expert),
            Self::Policy => Some(Party::Policy),
            Self::Similar | Self::Abstained | Self::Failed => None,
        }
    }

    /// The answer in one word.
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

/// What the simulator foresees if a proposal were held.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Outlook {
    /// The party of the proposal.
    pub party: Party,
    /// Horizon, s.
    pub horizon_s: f64,
    /// Time to the first contact, s; the horizon if there is none.
    pub contact_s: f64,
    /// Time to leaving the road, s; the horizon if the car stays on it.
    pub out_s: f64,
}

impl Outlook {
    /// The rollout ends in a contact or off the road.
    pub fn is_accident(&self) -> bool {
        self.contact_s < self.horizon_s || self.out_s < self.horizon_s
    }
}

/// What happened after the question, with any driver.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Aftermath {
    /// Ticks in the window.
    pub ticks: u32,
    /// Ticks the expert drove.
    pub expert: u32,
    /// Ticks the policy drove.
    pub policy: u32,
    /// Ticks the brake drove.
    pub brake: u32,
    /// Ticks in which the safety check vetoed the driver in charge.
    pub vetoed: u32,
    /// Least clearance of the driver's rollout, as the safety check measured it, m; of
    /// the expert's rollout while the brake drove.
    pub clearance_m: f64,
    /// The episode ended within the window.
    pub ended: bool,
}
