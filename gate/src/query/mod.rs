//! A question to a judge, its answer, and the queues between them.

mod occasion;
mod queue;

pub use occasion::Occasion;
pub use queue::{Immediate, QueryQueue, Serve, Threaded};

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng as _, SeedableRng as _};
use shm_config::message::{
    Assessment, Judge as JudgeKind, Observation, Preference, Proposal, Step,
};
use shm_config::{Instant, Message};

/// One question: which of two proposals is safer here?
#[derive(Debug, Clone)]
pub struct Question {
    /// The observation; its tick and time identify the question.
    pub observation: Observation,
    /// The expert's proposal.
    pub expert: Proposal,
    /// The policy's proposal.
    pub policy: Proposal,
    /// The tick's assessment of the expert's proposal.
    pub expert_assessment: Assessment,
    /// The tick's assessment of the policy's proposal.
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

    /// The question's identity.
    pub fn id(&self) -> QuestionId {
        QuestionId::of(&self.observation)
    }
}

/// The identity of a question within a run: its observation's episode, tick and instant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QuestionId {
    /// The run's episode, from 0.
    pub episode: u32,
    /// The run's tick.
    pub tick: u64,
    /// When the observation was taken, on the run's clock.
    pub taken: Instant,
}

impl QuestionId {
    /// The identity of the question about this observation.
    pub fn of(observation: &Observation) -> Self {
        let header = observation.header();
        Self {
            episode: header.episode,
            tick: header.tick,
            taken: header.taken(),
        }
    }

    /// Episode and tick; they identify a record.
    pub fn key(self) -> (u32, u64) {
        (self.episode, self.tick)
    }

    /// A number that differs between neighbouring questions; it seeds random draws that
    /// depend on the question alone.
    pub fn seed(self) -> u64 {
        (self.tick ^ (u64::from(self.episode) << 40)).wrapping_mul(0x9e37_79b9)
    }

    /// Uniform shares from 0 inclusive to 1 exclusive that depend on the question and this
    /// salt alone, so runs repeat.
    pub fn shares(self, salt: u64) -> impl Iterator<Item = f64> {
        let mut random = SplitMix64::seed_from_u64(self.seed() ^ salt);
        // Neighbouring seeds give similar first numbers, so the first is skipped.
        let _ = random.next_u64();
        std::iter::repeat_with(move || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64)
    }
}

/// Why a judge did not answer. A failure is never read as a preference.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// The judge did not answer in time.
    Timeout,
    /// The judge cannot be reached or has failed.
    Unavailable,
    /// The answer is not in the required form.
    Malformed,
    /// The judge refused to answer.
    Refused,
    /// The budget is spent.
    Budget,
}

impl Failure {
    /// The failure in one word, for records.
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

/// A judge's answer to one question.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// The question.
    pub question: QuestionId,
    /// The preference, or why there is none. [`Preference::Abstain`] is an answer
    /// without a preference.
    pub preference: Result<Preference, Failure>,
    /// Cost of the answer, US dollars.
    pub cost_usd: f64,
}

impl Answer {
    /// A preference, at no cost.
    pub fn free(question: QuestionId, preference: Preference) -> Self {
        Self {
            question,
            preference: Ok(preference),
            cost_usd: 0.0,
        }
    }

    /// No answer, at no cost.
    pub fn failed(question: QuestionId, failure: Failure) -> Self {
        Self {
            question,
            preference: Err(failure),
            cost_usd: 0.0,
        }
    }
}

/// A judge: compares two proposals, at its own pace.
pub trait Judge: Send {
    /// What kind of judge it is, for the record.
    fn kind(&self) -> JudgeKind;

    /// Answers one question. It may block on a thread of its own ([`Threaded`]).
    fn ask(&mut self, question: &Question) -> Answer;
}
