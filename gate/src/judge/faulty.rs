use std::collections::VecDeque;

use shm_config::Instant;
use shm_config::config;
use shm_config::message::{Judge as JudgeKind, Preference, Step};

use crate::query::{Answer, QueryQueue, Question, QuestionId};

/// Answers that are delayed at the same time: enough for a judge that is asked once a
/// second and answers a minute later. When there are more, the oldest is dropped.
pub(super) const DELAYED_MAX: usize = 64;

/// A judge whose answers are inverted, withheld or delayed. It measures how much of
/// this driving and learning tolerate.
///
/// The fault of an answer depends only on the seed and the question, so runs repeat.
pub struct FaultyJudge {
    queue: Box<dyn QueryQueue>,
    noise: f64,
    abstention: f64,
    delay_ns: u64,
    seed: u64,
    /// The delayed answers, the oldest first.
    delayed: VecDeque<Answer>,
}

impl FaultyJudge {
    /// Injects the configured faults into the answers of this queue.
    pub fn new(config: &config::FaultyJudge, queue: Box<dyn QueryQueue>) -> Self {
        Self {
            queue,
            noise: config.noise,
            abstention: config.abstention,
            delay_ns: (config.delay_s * 1e9) as u64,
            seed: config.seed,
            delayed: VecDeque::with_capacity(DELAYED_MAX),
        }
    }

    fn disturb(&self, question: QuestionId, preference: Preference) -> Preference {
        let mut shares = question.shares(self.seed);
        let mut happens = |share: f64| shares.next().is_some_and(|drawn| drawn < share);
        let (is_inverted, is_withheld) = (happens(self.noise), happens(self.abstention));
        match preference {
            Preference::Expert | Preference::Policy if is_withheld => Preference::Abstain,
            Preference::Expert if is_inverted => Preference::Policy,
            Preference::Policy if is_inverted => Preference::Expert,
            preference => preference,
        }
    }
}

impl QueryQueue for FaultyJudge {
    fn kind(&self) -> JudgeKind {
        self.queue.kind()
    }

    fn put(&mut self, question: Question) -> bool {
        self.queue.put(question)
    }

    fn take(&mut self, now: Instant) -> Option<Answer> {
        while let Some(mut answer) = self.queue.take(now) {
            if self.delayed.len() == DELAYED_MAX {
                self.delayed.pop_front();
            }
            let preference = answer.preference;
            answer.preference = preference.map(|said| self.disturb(answer.question, said));
            self.delayed.push_back(answer);
        }
        let first = self.delayed.front()?;
        let is_due = now >= first.question.taken.after_ns(self.delay_ns);
        is_due.then(|| self.delayed.pop_front()).flatten()
    }

    fn awaited(&self) -> usize {
        // The run's clock stands still while a judge answers; it advances while an
        // answer is delayed.
        self.queue.awaited()
    }

    fn wants(&self, step: &Step) -> Option<bool> {
        self.queue.wants(step)
    }

    fn pieces(&self) -> usize {
        self.queue.pieces()
    }

    fn unheard_cost_usd(&self) -> f64 {
        self.queue.unheard_cost_usd()
    }
}
