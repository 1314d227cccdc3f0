//! What is kept of every question: one line of JSON, and the pictures beside it.
//!
//! A run's folder holds `judge/questions.jsonl` and `judge/pictures/`.

mod archive;
mod query_log;
pub mod store;
mod tally;

use serde::{Deserialize, Serialize};
use shm_config::message::{Assessment, Proposal};

pub use archive::Archive;
pub use query_log::{Clerk, Evidence, Filed};

use crate::model::Asked;
use crate::presentation::{Party, Prompt, Reply, Showing};

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
    /// The answer: a word of [`Verdict`].
    pub verdict: Verdict,
    /// What each juror of a committee said; `None` for who had not when it was
    /// decided. Empty for any other judge.
    #[serde(default)]
    pub votes: Vec<Vote>,
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
        Said::of(self.verdict, &self.askings)
    }

    /// Why there is no answer, in one word; `None` where there is one.
    pub fn failure(&self) -> Option<&str> {
        match (self.verdict, self.fault.as_str()) {
            (Verdict::Failed, "") => Some("unknown"),
            (Verdict::Failed, fault) => Some(fault),
            (Verdict::Expert | Verdict::Policy | Verdict::Abstain, _) => None,
        }
    }
}

/// What one juror of a committee said.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Vote {
    /// Who: a word of the configuration, such as `vlm`.
    pub juror: String,
    /// What; `None` for nothing before the committee had its quorum.
    pub verdict: Option<Verdict>,
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

/// Why a question was asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Occasion {
    /// An episode began.
    Episode,
    /// The period was over: `T_vlm` of Sec. 4.2.
    Period,
    /// The proposals differ by more than the threshold.
    Differ,
    /// The judge in the tick sees little clearance for one of them.
    Clearance,
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

/// An answer, for the record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The expert's path is safer: `z = 1` of Sec. 4.2.
    Expert,
    /// The policy's path is as safe or safer: `z = 0` of Sec. 4.2.
    Policy,
    /// No preference: the replies disagree.
    Abstain,
    /// No answer: never read as a preference.
    Failed,
}

/// A verdict, "similar" told apart: an answer that lets the policy drive, as the
/// paper's 0 does, but prefers nobody.
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

    /// What a verdict on these askings says.
    pub fn of(verdict: Verdict, askings: &[Asking]) -> Self {
        let is_similar = |asking: &Asking| asking.reply == Some(Reply::Similar);
        match verdict {
            Verdict::Policy if !askings.is_empty() && askings.iter().all(is_similar) => {
                Self::Similar
            }
            Verdict::Expert => Self::Expert,
            Verdict::Policy => Self::Policy,
            Verdict::Abstain => Self::Abstained,
            Verdict::Failed => Self::Failed,
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

impl From<crate::query::Answer> for Verdict {
    fn from(answer: crate::query::Answer) -> Self {
        match answer {
            crate::query::Answer::Expert => Self::Expert,
            crate::query::Answer::Policy => Self::Policy,
            crate::query::Answer::Abstain => Self::Abstain,
            crate::query::Answer::Failed(_) => Self::Failed,
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
