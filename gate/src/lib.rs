//! Who may drive.
//!
//! The gate has two halves. [`assess`] is the judge in the tick: a pure function
//! that rolls a proposal out with the bicycle model and measures it against the
//! lidar returns and the road, by exact geometry; it may veto. The gate
//! *process* asks a slower [`Judge`] at its own pace through a [`Docket`], and
//! publishes advice that expires. Nothing the process does can delay a tick.

mod assess;
mod counsel;
mod docket;
mod flaws;
mod road;
mod rules;

pub use assess::{CLEARANCE_MAX_M, Scene, assess};
pub use counsel::Counsel;
pub use docket::Docket;
pub use flaws::Flaws;
pub use road::RoadAhead;
pub use rules::Rules;

use shm_config::message::{Judge as JudgeKind, Observation, Proposal};

/// One question: which of two proposals is safer here?
#[derive(Debug, Clone, Copy)]
pub struct Question {
    /// What the car perceived; its tick and time are the question's.
    pub observation: Observation,
    /// What the expert proposed.
    pub expert: Proposal,
    /// What the policy proposed.
    pub policy: Proposal,
}

/// Why a judge did not answer. None of these is ever read as a preference.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// It did not answer in time.
    Timeout,
    /// It cannot be reached or broke down.
    Unavailable,
    /// It answered something that is no answer.
    Malformed,
    /// It would not answer.
    Refused,
    /// The budget is spent.
    Budget,
}

/// A judge's answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// The expert's proposal is safer: `z = 1` of Sec. 4.2.
    Expert,
    /// The policy's proposal is as safe or safer: `z = 0` of Sec. 4.2.
    Policy,
    /// It has no preference it would stand by.
    Abstain,
    /// There is no answer.
    Failed(Failure),
}

/// An answer and what it cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ruling {
    /// The answer.
    pub answer: Answer,
    /// What it cost, US dollars.
    pub cost_usd: f64,
}

/// Somebody who compares two proposals, however slowly.
pub trait Judge: Send {
    /// What kind of judge it is, for the record.
    fn kind(&self) -> JudgeKind;

    /// Answers one question. May take as long as it likes: a [`Docket`] with a
    /// thread keeps the gate process alive meanwhile.
    fn ask(&mut self, question: &Question) -> Ruling;
}
