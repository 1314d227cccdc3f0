use std::collections::VecDeque;

use shm_config::config::Gate;
use shm_config::message::{Advice, Judge as JudgeKind, Preference, Step};
use shm_config::{Instant, Message};

use crate::advice::{Dwell, Occasions};
use crate::judge::Flaws;
use crate::query::{Answer, Docket, Occasion, Question, Ruling};

/// Answers that may be on their way: of a judge that is asked once a second and
/// heard a minute later. The oldest is lost when there are more.
const LATE_MAX: usize = 64;

/// The gate process without its ports: steps in, advice out.
pub struct Counsel {
    docket: Box<dyn Docket>,
    occasions: Occasions,
    flaws: Flaws,
    dwell: Dwell,
    /// Answers that are not to be heard yet, the oldest first.
    late: VecDeque<(Question, Ruling)>,
    hold_ns: u64,
    label_ns: u64,
    advice: Advice,
    cost_usd: f64,
}

/// An answer that was heard.
#[derive(Debug, Clone, Copy)]
pub struct Heard {
    /// What was asked.
    pub question: Question,
    /// What came, with the flaws that were asked for.
    pub ruling: Ruling,
}

impl Counsel {
    /// Asks this judge on the configured occasions.
    pub fn new(config: &Gate, docket: Box<dyn Docket>) -> Self {
        Self {
            docket,
            occasions: Occasions::new(config),
            flaws: Flaws::new(config),
            dwell: Dwell::new(config),
            late: VecDeque::with_capacity(LATE_MAX),
            hold_ns: (config.hold_s * 1e9) as u64,
            label_ns: config.label_ns(),
            advice: Advice::default(),
            cost_usd: 0.0,
        }
    }

    /// Asks about this step when there is reason to; `None` when there is none or
    /// the judge has enough to do.
    ///
    /// Reason is a new episode, a period that is over (Sec. 4.2), and with
    /// `gate.when = "matters"` proposals far apart or near something.
    pub fn ask(&mut self, step: &Step) -> Option<(Question, Occasion)> {
        self.follow(step);
        let observation = &step.observation;
        let has_seen = observation.header.taken_ns > 0 || observation.header.sequence > 0;
        let occasion = match self.docket.wants(step) {
            Some(true) => Occasion::Period,
            Some(false) => return None,
            None => self.occasions.at(step)?,
        };
        let has_pair = step.expert.action().is_some() && step.policy.action().is_some();
        // Geometry costs nothing and has an answer to half a pair; a model is
        // asked only where there is a choice.
        let is_worth = has_pair || self.docket.kind() == JudgeKind::Rules;
        if !has_seen || !is_worth {
            return None;
        }
        let question = Question::about(step);
        if !self.docket.put(&question) {
            return None;
        }
        self.occasions.asked(step);
        Some((question, occasion))
    }

    /// Questions whose answers a run in lockstep has to wait for.
    pub fn awaited(&self) -> usize {
        self.docket.awaited()
    }

    /// What kind of judge is asked.
    pub fn kind(&self) -> JudgeKind {
        self.docket.kind()
    }

    /// Takes in what the judge has answered, to be heard when it is due.
    pub fn collect(&mut self, now: Instant) {
        while let Some((question, ruling)) = self.docket.take(now) {
            if self.late.len() == LATE_MAX {
                self.late.pop_front();
            }
            let ruling = self.flaws.apply(&question, ruling);
            self.cost_usd += ruling.cost_usd;
            self.late.push_back((question, ruling));
        }
    }

    /// Hears an answer when one is due: one a call, so that no reader of the
    /// advice misses one.
    pub fn hear(&mut self, now: Instant) -> Option<Heard> {
        self.collect(now);
        let is_due = |(question, _): &(Question, Ruling)| now >= self.flaws.due(question);
        if !self.late.front().is_some_and(is_due) {
            return None;
        }
        let (question, ruling) = self.late.pop_front()?;
        self.settle(&question, ruling.answer, now);
        Some(Heard { question, ruling })
    }

    fn settle(&mut self, question: &Question, answer: Answer, now: Instant) {
        let header = question.observation.header;
        let said = match answer {
            Answer::Expert => Preference::Expert,
            Answer::Policy => Preference::Policy,
            // No label, and the expert drives: never read as a preference.
            Answer::Abstain | Answer::Failed(_) => Preference::Abstain,
        };
        let advice = &mut self.advice;
        let is_of_now = question.episode() == advice.header.episode;
        advice.answers += 1;
        advice.judge = self.docket.kind().code();
        advice.label = said.code();
        advice.label_from_ns = header.taken_ns;
        advice.label_until_ns = header.taken().after_ns(self.label_ns).0;
        // An answer that was overtaken teaches, and decides no more.
        if !is_of_now || header.tick < advice.question_tick {
            return;
        }
        advice.question_tick = header.tick;
        advice.question_taken_ns = header.taken_ns;
        advice.answered_ns = now.0;
        advice.holds_until_ns = header.taken().after_ns(self.hold_ns).0;
        self.dwell.hear(said, now);
    }

    /// The step is the newest now. What was said of another episode, or of a run
    /// with another clock, is no advice in this one.
    fn follow(&mut self, step: &Step) {
        let before = self.advice.header;
        let header = step.header();
        let advice = &mut self.advice;
        advice.header.tick = header.tick;
        advice.header.episode = header.episode;
        advice.header.taken_ns = header.taken_ns;
        if header.episode != before.episode || header.taken_ns < before.taken_ns {
            self.dwell.begin();
            advice.question_tick = 0;
            advice.holds_until_ns = 0;
        }
    }

    /// The advice in force, about the step asked about last, to be published.
    pub fn advise(&mut self, now: Instant) -> Advice {
        self.advice.preference = self.dwell.in_force(now).code();
        self.advice
    }

    /// Asks, hears and advises: one step of a judge that answers at once, or of
    /// a run in real time.
    pub fn consider(&mut self, step: &Step, now: Instant) -> Advice {
        self.ask(step);
        self.hear(now);
        self.advise(now)
    }

    /// What all answers have cost so far, US dollars.
    pub fn cost_usd(&self) -> f64 {
        self.cost_usd
    }
}
