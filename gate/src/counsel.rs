use std::collections::VecDeque;

use shm_config::config::Gate;
use shm_config::message::{Advice, Preference, Step};
use shm_config::{Instant, Message};

use crate::{Answer, Docket, Flaws, Question, Ruling};

/// Answers that may be on their way: of a judge that is asked once a second and
/// heard a minute later. The oldest is lost when there are more.
const LATE_MAX: usize = 64;

/// The gate process without its ports: steps in, advice out.
pub struct Counsel {
    docket: Docket,
    flaws: Flaws,
    /// Answers that are not to be heard yet, the oldest first.
    late: VecDeque<(Question, Ruling)>,
    period_ns: u64,
    hold_ns: u64,
    asked: Option<Asked>,
    advice: Advice,
    cost_usd: f64,
}

#[derive(Clone, Copy, PartialEq, Eq)]
struct Asked {
    taken: Instant,
    episode: u32,
}

impl Counsel {
    /// Asks this judge at the configured cadence.
    pub fn new(config: &Gate, docket: Docket) -> Self {
        Self {
            docket,
            flaws: Flaws::new(config),
            late: VecDeque::with_capacity(LATE_MAX),
            period_ns: (config.period_s * 1e9) as u64,
            hold_ns: (config.hold_s * 1e9) as u64,
            asked: None,
            advice: Advice::default(),
            cost_usd: 0.0,
        }
    }

    /// Considers one step: asks when a question is due, takes in an answer when
    /// there is one, and returns the advice in force, to be published.
    ///
    /// A question is due `T_vlm` after the last one (Sec. 4.2), and at once in a
    /// new episode. A step whose clock runs backwards begins a new run.
    pub fn consider(&mut self, step: &Step, now: Instant) -> Advice {
        let observation = &step.observation;
        let asking = Asked {
            taken: observation.header.taken(),
            episode: observation.header.episode,
        };
        let due = match self.asked {
            None => true,
            Some(last) => {
                last.episode != asking.episode
                    || asking.taken < last.taken
                    || asking.taken.since_ns(last.taken) >= self.period_ns
            }
        };
        let has_seen = observation.header.taken_ns > 0 || observation.header.sequence > 0;
        if due && has_seen {
            let put = self.docket.put(Question {
                observation: *observation,
                expert: step.expert,
                policy: step.policy,
            });
            if put {
                self.asked = Some(asking);
            }
        }
        self.hear(now);
        self.advice.header.tick = step.header().tick;
        self.advice.header.episode = step.header().episode;
        self.advice.header.taken_ns = step.header().taken_ns;
        self.advice
    }

    /// Takes in an answer when there is one.
    fn hear(&mut self, now: Instant) {
        if let Some((question, ruling)) = self.docket.take() {
            if self.late.len() == LATE_MAX {
                self.late.pop_front();
            }
            let ruling = self.flaws.apply(&question, ruling);
            self.late.push_back((question, ruling));
        }
        let is_due = |(question, _): &(Question, Ruling)| now >= self.flaws.due(question);
        if !self.late.front().is_some_and(is_due) {
            return;
        }
        let Some((question, ruling)) = self.late.pop_front() else {
            return;
        };
        self.cost_usd += ruling.cost_usd;
        let header = question.observation.header;
        self.advice.question_tick = header.tick;
        self.advice.question_taken_ns = header.taken_ns;
        self.advice.answered_ns = now.0;
        self.advice.holds_until_ns = header.taken().after_ns(self.hold_ns).0;
        self.advice.answers += 1;
        self.advice.judge = self.docket.kind().code();
        self.advice.preference = match ruling.answer {
            Answer::Expert => Preference::Expert,
            Answer::Policy => Preference::Policy,
            // No label, and the expert drives: never read as a preference.
            Answer::Abstain | Answer::Failed(_) => Preference::Abstain,
        }
        .code();
    }

    /// What all answers have cost so far, US dollars.
    pub fn cost_usd(&self) -> f64 {
        self.cost_usd
    }
}
