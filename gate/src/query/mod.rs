//! A question to a judge, its answer, and the queues between them.

mod occasion;
mod queue;

pub use occasion::Occasion;
pub use queue::{AtOnce, Committee, Docket, Serve, Threaded};

use shm_config::config::JURORS_MAX;
use shm_config::message::{Assessment, Judge as JudgeKind, Observation, Proposal, Step};

/// One question: which of two proposals is safer here?
#[derive(Debug, Clone, Copy)]
pub struct Question {
    /// What the car perceived; its tick and time are the question's.
    pub observation: Observation,
    /// What the expert proposed.
    pub expert: Proposal,
    /// What the policy proposed.
    pub policy: Proposal,
    /// The judge in the tick on the expert's proposal.
    pub expert_assessment: Assessment,
    /// The judge in the tick on the policy's proposal.
    pub policy_assessment: Assessment,
}

impl Question {
    /// Which proposal of this step is safer.
    pub fn about(step: &Step) -> Self {
        Self {
            observation: step.observation,
            expert: step.expert,
            policy: step.policy,
            expert_assessment: step.expert_assessment,
            policy_assessment: step.policy_assessment,
        }
    }

    /// The run's episode.
    pub fn episode(&self) -> u32 {
        self.observation.header.episode
    }

    /// What tells the questions of a run apart: episode and tick.
    pub fn key(&self) -> (u32, u64) {
        (self.episode(), self.observation.header.tick)
    }
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

impl Failure {
    /// One word for people and records.
    pub fn word(self) -> &'static str {
        match self {
            Self::Timeout => "timeout",
            Self::Unavailable => "unavailable",
            Self::Malformed => "malformed",
            Self::Refused => "refused",
            Self::Budget => "budget",
        }
    }
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
    /// What each juror of a committee said, in their order; `None` for who had
    /// not when it was decided, and for everybody else's judge.
    pub votes: [Option<Answer>; JURORS_MAX],
}

impl Ruling {
    /// One judge's answer.
    pub fn new(answer: Answer, cost_usd: f64) -> Self {
        Self {
            answer,
            cost_usd,
            votes: [None; JURORS_MAX],
        }
    }

    /// No answer, at no cost.
    pub fn failed(failure: Failure) -> Self {
        Self::new(Answer::Failed(failure), 0.0)
    }
}

/// Somebody who compares two proposals, however slowly.
pub trait Judge: Send {
    /// What kind of judge it is, for the record.
    fn kind(&self) -> JudgeKind;

    /// Answers one question. May take as long as it likes on a thread of its own
    /// ([`Threaded`]).
    fn ask(&mut self, question: &Question) -> Ruling;
}
