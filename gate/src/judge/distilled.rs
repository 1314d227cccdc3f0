//! A distilled net in front of a slow judge.

use std::collections::VecDeque;
use std::sync::mpsc::Sender;

use shm_config::Instant;
use shm_config::config::IN_FLIGHT_MAX;
use shm_config::message::{Judge as JudgeKind, Preference};
use vehicle::Vehicle;

use super::faulty::DELAYED_MAX;
use super::lookout::Lookout;
use crate::distilled::{DistilledNet, Opinion};
use crate::query::{Answer, QueryQueue, Question, QuestionId};
use crate::record::{Evidence, NetOpinion, Unsure};

/// Audits that may be open. An audit that is forgotten before its answer comes would let that
/// answer decide; so there is room for all answers that can still come, and what is dropped
/// beyond them was never answered.
const AUDITS_MAX: usize = 128;
const _: () = assert!(AUDITS_MAX >= DELAYED_MAX + IN_FLIGHT_MAX as usize);
/// Separates the draw of audits from that of faults.
const AUDIT_SALT: u64 = 0x0061_7564_6974;

/// A judge that asks a small net first. Where the net is sure, it answers at once; the
/// other questions go to a slow judge. A share of the net's answers is audited: where the
/// slow judge has no other open question, it is asked, too, and its answer is recorded and
/// decides nothing. Its question occupies a place of `gate.in_flight`, and counts for
/// `vlm.per_minute_max`: with a single place, a doubtful question waits until the audit is
/// answered.
///
/// A failure gives no answer: a net that gives no number is not sure, and the
/// failure of the slow judge is a failure.
pub struct Distilled {
    net: DistilledNet,
    vehicle: Vehicle,
    slow: Box<dyn QueryQueue>,
    /// Share of the net's answers that are audited.
    audit: f64,
    clock: fn() -> Instant,
    evidence: Sender<Evidence>,
    lookout: Option<Lookout>,
    /// The net's answers that were not taken yet.
    answers: VecDeque<Answer>,
    /// Questions that the slow judge is asked for the record alone.
    audits: VecDeque<QuestionId>,
    audit_cost_usd: f64,
}

impl Distilled {
    /// This net in front of this slow judge.
    pub fn new(
        (net, vehicle): (DistilledNet, Vehicle),
        slow: Box<dyn QueryQueue>,
        audit: f64,
        (evidence, clock): (Sender<Evidence>, fn() -> Instant),
    ) -> Self {
        Self {
            net,
            vehicle,
            slow,
            audit,
            clock,
            evidence,
            lookout: None,
            answers: VecDeque::with_capacity(2),
            audits: VecDeque::with_capacity(AUDITS_MAX),
            audit_cost_usd: 0.0,
        }
    }

    /// Adds the world's foresight to the record of the questions for which the slow judge
    /// does not bring it.
    pub fn with_lookout(mut self, lookout: Lookout) -> Self {
        self.lookout = Some(lookout);
        self
    }

    /// Whether a question is audited: it depends on the question alone, so runs repeat.
    fn is_audited(&self, question: QuestionId) -> bool {
        let mut shares = question.shares(AUDIT_SALT);
        shares.next().is_some_and(|share| share < self.audit)
    }

    /// Reports what the net thought, and how many further pieces of evidence follow.
    fn report(&self, question: QuestionId, opinion: NetOpinion, begun: Instant, follow: usize) {
        let about = &self.net.about;
        let _ = self.evidence.send(Evidence {
            key: question.key(),
            preset: about.preset.clone(),
            model: format!("distilled from {}", about.teacher),
            latency_s: (self.clock)().since_ns(begun) as f64 / 1e9,
            net: Some(opinion),
            follow,
            ..Evidence::default()
        });
    }
}

impl QueryQueue for Distilled {
    fn kind(&self) -> JudgeKind {
        JudgeKind::Distilled
    }

    fn put(&mut self, question: Question) -> bool {
        let (id, begun) = (question.id(), (self.clock)());
        let opinion = self.net.judge(&question, &self.vehicle);
        let sure = opinion.filter(|opinion| self.net.is_sure(opinion));
        // Beside another question, an audit would take the place of the next doubtful one.
        let is_audit = sure.is_some() && self.slow.awaited() == 0 && self.is_audited(id);
        // An audit for which there is no room is left out.
        let asks_slow = (sure.is_none() || is_audit) && self.slow.put(question.clone());
        if sure.is_none() && !asks_slow {
            // The queue is full: the question is asked again later.
            return false;
        }
        let is_audit = is_audit && asks_slow;
        let mut follow = usize::from(is_audit);
        if asks_slow {
            follow += self.slow.pieces();
        }
        let brings_foresight = asks_slow && self.slow.kind() == JudgeKind::Vlm;
        if let Some(lookout) = self.lookout.as_ref().filter(|_| !brings_foresight) {
            lookout.look(&question);
            follow += 1;
        }
        let unsure = match (sure, opinion) {
            (Some(_), _) => None,
            (None, Some(opinion)) if opinion.is_novel => Some(Unsure::Novel),
            (None, Some(_)) => Some(Unsure::Doubt),
            (None, None) => Some(Unsure::Unfit),
        };
        self.report(id, recorded(opinion, unsure), begun, follow);
        if let Some(opinion) = sure {
            self.answers
                .push_back(Answer::free(id, opinion.preference()));
        }
        if is_audit {
            if self.audits.len() == AUDITS_MAX {
                self.audits.pop_front();
            }
            self.audits.push_back(id);
        }
        true
    }

    fn take(&mut self, now: Instant) -> Option<Answer> {
        if let Some(answer) = self.answers.pop_front() {
            return Some(answer);
        }
        while let Some(answer) = self.slow.take(now) {
            let audit = self.audits.iter().position(|id| *id == answer.question);
            let Some(audit) = audit.and_then(|at| self.audits.remove(at)) else {
                return Some(answer);
            };
            self.audit_cost_usd += answer.cost_usd;
            let _ = self.evidence.send(Evidence {
                key: audit.key(),
                audit: Some(answer.preference.ok()),
                cost_usd: answer.cost_usd,
                ..Evidence::default()
            });
        }
        None
    }

    fn awaited(&self) -> usize {
        let looked = self.lookout.as_ref().map_or(0, Lookout::open);
        self.answers.len() + self.slow.awaited() + looked
    }

    fn pieces(&self) -> usize {
        // What the net thought; it says what follows.
        1
    }

    fn unheard_cost_usd(&self) -> f64 {
        self.audit_cost_usd
    }
}

fn recorded(opinion: Option<Opinion>, unsure: Option<Unsure>) -> NetOpinion {
    NetOpinion {
        expert: opinion.map(|opinion| opinion.expert),
        policy: opinion.map(|opinion| opinion.policy),
        similar: opinion.map(|opinion| opinion.similar),
        passed_on: unsure,
        audit: None,
    }
}

/// What an audited answer and the slow judge's have in common: whether the same driver
/// would drive. An abstention and a failure are no answer.
pub fn agree(net: Preference, slow: Preference) -> Option<bool> {
    match slow {
        Preference::Abstain => None,
        Preference::Expert | Preference::Policy => Some(net == slow),
    }
}
