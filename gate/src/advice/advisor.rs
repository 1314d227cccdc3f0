use std::collections::VecDeque;

use shm_config::config::Gate;
use shm_config::message::{Advice, Judge as JudgeKind, Preference, Step};
use shm_config::{Instant, Message};

use crate::advice::{Dwell, QueryPolicy};
use crate::query::{Answer, Occasion, QueryQueue, Question};

/// Answers that wait to be published, one for each step. When there are more, the
/// oldest is dropped.
const WAITING_MAX: usize = 64;

/// The gate process without its ports: steps in, advice out.
pub struct Advisor {
    queue: Box<dyn QueryQueue>,
    policy: QueryPolicy,
    dwell: Dwell,
    /// Answers that are not published yet, the oldest first.
    waiting: VecDeque<Answer>,
    hold_ns: u64,
    label_ns: u64,
    advice: Advice,
    cost_usd: f64,
}

impl Advisor {
    /// Asks the judge behind this queue on the configured occasions.
    pub fn new(config: &Gate, queue: Box<dyn QueryQueue>) -> Self {
        Self {
            queue,
            policy: QueryPolicy::new(config),
            dwell: Dwell::new(config),
            waiting: VecDeque::with_capacity(WAITING_MAX),
            hold_ns: (config.hold_s * 1e9) as u64,
            label_ns: config.label_ns(),
            advice: Advice::default(),
            cost_usd: 0.0,
        }
    }

    /// Asks about this step if there is an occasion; `None` if there is none or the
    /// queue is full.
    ///
    /// An occasion is a new episode, the end of a period (Sec. 4.2), and with
    /// `gate.when = "matters"` a step whose proposals differ much or come near
    /// something.
    pub fn ask(&mut self, step: &Step) -> Option<Occasion> {
        self.follow(step);
        let observation = &step.observation;
        let has_seen = observation.header.taken_ns > 0 || observation.header.sequence > 0;
        let occasion = match self.queue.wants(step) {
            Some(true) => Occasion::Period,
            Some(false) => return None,
            None => self.policy.at(step)?,
        };
        let has_pair = step.expert.action().is_some() && step.policy.action().is_some();
        // The geometric judge costs nothing and also assesses a single proposal; a
        // model is asked only where there is a choice.
        let is_worth = has_pair || self.queue.kind() == JudgeKind::Rules;
        if !has_seen || !is_worth || !self.queue.put(Question::about(step)) {
            return None;
        }
        self.policy.asked(step);
        Some(occasion)
    }

    /// Questions whose answers a run in lockstep has to wait for.
    pub fn awaited(&self) -> usize {
        self.queue.awaited()
    }

    /// The judge that is asked.
    pub fn queue(&self) -> &dyn QueryQueue {
        &*self.queue
    }

    /// Takes the answers that have arrived; [`Advisor::hear`] publishes them.
    pub fn collect(&mut self, now: Instant) {
        while let Some(answer) = self.queue.take(now) {
            if self.waiting.len() == WAITING_MAX {
                self.waiting.pop_front();
            }
            self.cost_usd += answer.cost_usd;
            self.waiting.push_back(answer);
        }
    }

    /// Applies the oldest waiting answer. It applies one a call, so that no reader of
    /// the advice misses one.
    pub fn hear(&mut self, now: Instant) -> Option<Answer> {
        self.collect(now);
        let answer = self.waiting.pop_front()?;
        self.settle(&answer, now);
        Some(answer)
    }

    fn settle(&mut self, answer: &Answer, now: Instant) {
        let question = answer.question;
        // A failure makes no label, and the expert drives.
        let preference = answer.preference.unwrap_or(Preference::Abstain);
        let advice = &mut self.advice;
        advice.answers += 1;
        advice.judge = self.queue.kind().code();
        advice.label = preference.code();
        advice.label_from_ns = question.taken.0;
        advice.label_until_ns = question.taken.after_ns(self.label_ns).0;
        // An answer to an older question than the last one becomes a label and decides
        // nothing.
        let is_current = question.episode == advice.header.episode;
        if !is_current || question.tick < advice.question_tick {
            return;
        }
        advice.question_tick = question.tick;
        advice.question_taken_ns = question.taken.0;
        advice.answered_ns = now.0;
        advice.holds_until_ns = question.taken.after_ns(self.hold_ns).0;
        self.dwell.hear(preference, now);
    }

    /// Follows the newest step. Answers about another episode, or about a run with
    /// another clock, do not apply to this one.
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

    /// The advice in force, about the step that was last asked about.
    pub fn advise(&mut self, now: Instant) -> Advice {
        self.advice.preference = self.dwell.in_force(now).code();
        self.advice.considered_ns = now.0;
        self.advice
    }

    /// Asks, hears and advises: everything that one step needs when the judge answers
    /// at once or the run is in real time.
    pub fn consider(&mut self, step: &Step, now: Instant) -> Advice {
        self.ask(step);
        self.hear(now);
        self.advise(now)
    }

    /// What all answers have cost so far, US dollars.
    pub fn cost_usd(&self) -> f64 {
        self.cost_usd + self.queue.unheard_cost_usd()
    }
}
