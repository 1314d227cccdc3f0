use std::collections::{HashMap, VecDeque};

use shm_config::message::{Judge as JudgeKind, Preference, Step};
use shm_config::{Instant, Message};
use vehicle::Action;

use crate::query::{Answer, Failure, QueryQueue, Question, QuestionId};
use crate::record::{Proposed, Record};

/// The answers of a recorded run: asked at the ticks at which that run asked, and heard
/// at the ticks at which it heard them. In lockstep, the same seed then gives the same
/// commands, bit by bit.
pub struct Recorded {
    answers: HashMap<(u32, u64), Recollection>,
    /// Questions that differ from the recorded ones.
    strayed: u64,
    pending: VecDeque<(QuestionId, Recollection)>,
}

/// Numbers of one tick that differ by less are equal: JSON may round them.
const SAME: f64 = 1e-9;

#[derive(Clone, Copy)]
struct Recollection {
    preference: Result<Preference, Failure>,
    heard_ns: u64,
    speed_mps: f64,
    proposed: [Option<Action>; 2],
}

impl Recollection {
    /// Whether the question is the recorded one: equal speed and equal proposals.
    fn is_about(&self, question: &Question) -> bool {
        let speed_mps = question.observation.ego.speed_mps;
        let proposed = [question.expert.action(), question.policy.action()];
        let is_same = |(now, then): (&Option<Action>, &Option<Action>)| match (now, then) {
            (None, None) => true,
            (Some(now), Some(then)) => {
                (now.steer - then.steer).abs() < SAME && (now.pedal - then.pedal).abs() < SAME
            }
            (None, Some(_)) | (Some(_), None) => false,
        };
        (speed_mps - self.speed_mps).abs() < SAME
            && proposed.iter().zip(&self.proposed).all(is_same)
    }
}

impl Recorded {
    /// The answers of these records. Answers that were never heard stay unheard.
    pub fn new<'a>(records: impl IntoIterator<Item = &'a Record>) -> Self {
        let answers = records.into_iter().map(|record| {
            let action = |proposed: &Proposed| Action {
                steer: proposed.steer,
                pedal: proposed.pedal,
            };
            let recollection = Recollection {
                preference: record.preference.ok_or(Failure::Unavailable),
                heard_ns: record.heard_ns,
                speed_mps: record.speed_mps,
                proposed: [&record.expert, &record.policy].map(|p| p.as_ref().map(action)),
            };
            ((record.episode, record.tick), recollection)
        });
        Self {
            answers: answers.collect(),
            strayed: 0,
            pending: VecDeque::new(),
        }
    }
}

impl QueryQueue for Recorded {
    fn kind(&self) -> JudgeKind {
        JudgeKind::Recorded
    }

    fn put(&mut self, question: Question) -> bool {
        // Each record is used once: a tick that comes again belongs to another run.
        match self.answers.remove(&question.id().key()) {
            Some(recollection) if !recollection.is_about(&question) => {
                self.strayed += 1;
                if self.strayed == 1 {
                    tracing::warn!(
                        tick = question.id().tick,
                        "the recording is of another run: other speed or proposals; its answers \
                         are not used where they differ, and the expert drives"
                    );
                }
                let stray = Recollection {
                    preference: Err(Failure::Unavailable),
                    ..recollection
                };
                self.pending.push_back((question.id(), stray));
                true
            }
            Some(recollection) => {
                self.pending.push_back((question.id(), recollection));
                true
            }
            None => false,
        }
    }

    fn take(&mut self, now: Instant) -> Option<Answer> {
        let is_due = |(_, answer): &(QuestionId, Recollection)| {
            answer.heard_ns > 0 && answer.heard_ns <= now.0
        };
        let first = self.pending.iter().position(is_due)?;
        let (question, recollection) = self.pending.remove(first)?;
        Some(Answer {
            question,
            preference: recollection.preference,
            cost_usd: 0.0,
        })
    }

    fn awaited(&self) -> usize {
        // An answer comes at its recorded instant, even if the run waits for it.
        0
    }

    fn wants(&self, step: &Step) -> Option<bool> {
        let header = step.observation.header();
        Some(self.answers.contains_key(&(header.episode, header.tick)))
    }
}
