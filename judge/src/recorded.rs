use std::collections::{HashMap, VecDeque};

use gate::{Answer, Docket, Failure, Question, Ruling};
use shm_config::message::{Judge as JudgeKind, Step};
use shm_config::{Instant, Message};

use crate::record::{Record, Verdict};

/// The answers of a recorded run: asked where that run asked, heard when it
/// heard. In lockstep, from the same seed, the same commands follow bit by bit.
pub struct Recorded {
    answers: HashMap<(u32, u64), Recollection>,
    pending: VecDeque<(Question, Recollection)>,
}

#[derive(Clone, Copy)]
struct Recollection {
    answer: Answer,
    heard_ns: u64,
}

impl Recorded {
    /// The answers of these records; those that were never heard stay so.
    pub fn new<'a>(records: impl IntoIterator<Item = &'a Record>) -> Self {
        let answers = records.into_iter().map(|record| {
            let answer = match record.verdict {
                Verdict::Expert => Answer::Expert,
                Verdict::Policy => Answer::Policy,
                Verdict::Abstain => Answer::Abstain,
                Verdict::Failed => Answer::Failed(Failure::Unavailable),
            };
            let recollection = Recollection {
                answer,
                heard_ns: record.heard_ns,
            };
            ((record.episode, record.tick), recollection)
        });
        Self {
            answers: answers.collect(),
            pending: VecDeque::new(),
        }
    }
}

impl Docket for Recorded {
    fn kind(&self) -> JudgeKind {
        JudgeKind::Recorded
    }

    fn put(&mut self, question: &Question) -> bool {
        // Once each: a tick that comes again is another run's.
        match self.answers.remove(&question.key()) {
            Some(recollection) => {
                self.pending.push_back((*question, recollection));
                true
            }
            None => false,
        }
    }

    fn take(&mut self, now: Instant) -> Option<(Question, Ruling)> {
        let is_due = |(_, answer): &(Question, Recollection)| {
            answer.heard_ns > 0 && answer.heard_ns <= now.0
        };
        let first = self.pending.iter().position(is_due)?;
        let (question, recollection) = self.pending.remove(first)?;
        let ruling = Ruling {
            answer: recollection.answer,
            cost_usd: 0.0,
        };
        Some((question, ruling))
    }

    fn awaited(&self) -> usize {
        // They come when they came, not sooner for being waited for.
        0
    }

    fn wants(&self, step: &Step) -> Option<bool> {
        let header = step.observation.header();
        Some(self.answers.contains_key(&(header.episode, header.tick)))
    }
}
