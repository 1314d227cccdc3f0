use std::collections::VecDeque;

use safety::CLEARANCE_MAX_M;
use shm_config::message::{Driver, Preference, Reason, Step};
use shm_config::seen::Seen;
use shm_config::{Instant, Message};

use crate::presentation::picture::Picture;
use crate::query::{Answer, Occasion, QueryQueue};
use crate::record::{Aftermath, Asking, NetOpinion, Outlook, Proposed, Record, VERSION, word};

/// How long the steps after a question are watched, ns.
const AFTERMATH_NS: u64 = 3_000_000_000;
/// Open questions: enough for a judge that is asked once a second and answers after two
/// minutes. When there are more, the oldest is filed unfinished.
const OPEN_MAX: usize = 128;

/// What the thread that asks a model reports about a question.
#[derive(Debug, Clone, Default)]
pub struct Evidence {
    /// Episode and tick of the question.
    pub key: (u32, u64),
    /// Name of the prompt preset.
    pub preset: String,
    /// Name of the model.
    pub model: String,
    /// One asking, or two with the paths swapped.
    pub askings: Vec<Asking>,
    /// The pictures of the askings, in their order.
    pub pictures: Vec<Picture>,
    /// Why there is no preference; empty when there is one.
    pub fault: String,
    /// From question to answer, s of the wall clock.
    pub latency_s: f64,
    /// What the simulator foresaw for both proposals.
    pub foresight: Option<[Outlook; 2]>,
    /// Why the server gets no more questions; [`crate::model::Asker::trouble`].
    pub trouble: Option<String>,
    /// What a distilled net thought.
    pub net: Option<NetOpinion>,
    /// The slow judge's answer beside that of the net, and `None` in it for a failure.
    pub audit: Option<Option<Preference>>,
    /// Cost beside that of the answer, US dollars.
    pub cost_usd: f64,
    /// Further pieces of evidence that follow this one.
    pub follow: usize,
}

/// A finished record, with its pictures.
#[derive(Debug, Clone)]
pub struct Filed {
    /// The record.
    pub record: Record,
    /// The pictures of its askings, in their order.
    pub pictures: Vec<Picture>,
}

/// The log of every question: question, answer, and aftermath.
pub struct QueryLog {
    asked: u64,
    /// How long to wait for an answer, ns on the run's clock.
    patience_ns: u64,
    open: VecDeque<Case>,
    filed: Vec<Filed>,
}

struct Case {
    record: Record,
    pictures: Vec<Picture>,
    is_heard: bool,
    /// Pieces of evidence that are still expected.
    pieces: usize,
    aftermath: Aftermath,
    is_over: bool,
}

impl QueryLog {
    /// A log that waits at most this long for an answer, ns on the run's clock.
    pub fn new(patience_ns: u64) -> Self {
        Self {
            asked: 0,
            patience_ns,
            open: VecDeque::with_capacity(OPEN_MAX),
            filed: Vec::new(),
        }
    }

    /// Notes a question about this step.
    pub fn asked(&mut self, step: &Step, occasion: Occasion, judge: &dyn QueryQueue) {
        self.asked += 1;
        if self.open.len() == OPEN_MAX
            && let Some(case) = self.open.pop_front()
        {
            self.filed.push(case.file());
        }
        let header = step.observation.header();
        self.open.push_back(Case {
            record: Record {
                version: VERSION,
                question: self.asked,
                tick: header.tick,
                episode: header.episode,
                taken_ns: header.taken_ns,
                occasion,
                judge: judge.kind().to_string(),
                preset: String::new(),
                model: String::new(),
                speed_mps: step.observation.ego.speed_mps,
                observation: Some(Box::new(Seen::new(&step.observation))),
                expert: Proposed::new(&step.expert, &step.expert_assessment),
                policy: Proposed::new(&step.policy, &step.policy_assessment),
                askings: Vec::new(),
                preference: None,
                fault: "unheard".into(),
                latency_s: 0.0,
                cost_usd: 0.0,
                heard_tick: 0,
                heard_ns: 0,
                net: None,
                foresight: None,
                aftermath: None,
            },
            pictures: Vec::new(),
            is_heard: false,
            pieces: judge.pieces(),
            aftermath: Aftermath {
                ticks: 0,
                expert: 0,
                policy: 0,
                brake: 0,
                vetoed: 0,
                clearance_m: CLEARANCE_MAX_M,
                ended: false,
            },
            is_over: false,
        });
    }

    /// Adds the evidence of a question.
    pub fn learn(&mut self, evidence: Evidence) {
        let Some(case) = self.find(evidence.key) else {
            return;
        };
        let record = &mut case.record;
        if !evidence.preset.is_empty() || !evidence.model.is_empty() {
            (record.preset, record.model) = (evidence.preset, evidence.model);
        }
        record.askings.extend(evidence.askings);
        let net = record.net.as_ref();
        let is_answered = net.is_some_and(|net| net.passed_on.is_none());
        // The slow judge's fault and latency are not those of the net's answer.
        if !is_answered {
            if !evidence.fault.is_empty() {
                record.fault = evidence.fault;
            }
            record.latency_s = record.latency_s.max(evidence.latency_s);
        }
        record.net = evidence.net.or(record.net.take());
        if let (Some(net), Some(audit)) = (&mut record.net, evidence.audit) {
            net.audit = Some(word::of(audit).into());
        }
        record.cost_usd += evidence.cost_usd;
        record.foresight = record.foresight.or(evidence.foresight);
        case.pictures.extend(evidence.pictures);
        case.pieces = (case.pieces + evidence.follow).saturating_sub(1);
    }

    /// Adds the answer of a question.
    pub fn heard(&mut self, answer: &Answer, tick: u64, now: Instant) {
        let Some(case) = self.find(answer.question.key()) else {
            return;
        };
        case.is_heard = true;
        let record = &mut case.record;
        record.preference = answer.preference.ok();
        if record.fault == "unheard" {
            let failure = answer.preference.err();
            record.fault = failure.map_or_else(String::new, |failure| failure.word().into());
        }
        record.cost_usd += answer.cost_usd;
        record.heard_tick = tick;
        record.heard_ns = now.0;
    }

    /// Adds a step to the aftermath of the open questions.
    pub fn saw(&mut self, step: &Step) {
        let header = step.observation.header();
        for case in self.open.iter_mut().filter(|case| !case.is_over) {
            let record = &case.record;
            let since_ns = header.taken_ns.saturating_sub(record.taken_ns);
            let is_other = header.episode != record.episode || header.taken_ns < record.taken_ns;
            case.aftermath.ended = is_other;
            case.is_over = is_other || since_ns > AFTERMATH_NS;
            if !case.is_over {
                case.aftermath.count(step);
            }
        }
        let now_ns = step.header.taken_ns;
        let patience_ns = self.patience_ns;
        let mut open = VecDeque::with_capacity(OPEN_MAX);
        for case in self.open.drain(..) {
            let waited_ns = now_ns.saturating_sub(case.record.taken_ns);
            let is_complete = case.is_heard && case.pieces == 0;
            match case.is_over && (is_complete || waited_ns > patience_ns) {
                true => self.filed.push(case.file()),
                false => open.push_back(case),
            }
        }
        self.open = open;
    }

    /// Takes the finished records.
    pub fn filed(&mut self) -> Vec<Filed> {
        std::mem::take(&mut self.filed)
    }

    /// Finishes all records, because the run is over.
    pub fn finish(&mut self) -> Vec<Filed> {
        let open = self.open.drain(..).map(Case::file);
        self.filed.extend(open);
        self.filed()
    }

    fn find(&mut self, key: (u32, u64)) -> Option<&mut Case> {
        self.open
            .iter_mut()
            .rev()
            .find(|case| (case.record.episode, case.record.tick) == key)
    }
}

impl Case {
    fn file(mut self) -> Filed {
        self.record.aftermath = (self.aftermath.ticks > 0).then_some(self.aftermath);
        Filed {
            record: self.record,
            pictures: self.pictures,
        }
    }
}

impl Aftermath {
    fn count(&mut self, step: &Step) {
        self.ticks += 1;
        let (ticks, assessment) = match step.driver() {
            Driver::Expert => (&mut self.expert, &step.expert_assessment),
            Driver::Policy => (&mut self.policy, &step.policy_assessment),
            Driver::Brake => (&mut self.brake, &step.expert_assessment),
        };
        *ticks += 1;
        self.clearance_m = self.clearance_m.min(assessment.clearance_m);
        let is_vetoed = matches!(step.reason(), Some(Reason::Vetoed | Reason::Unsafe));
        self.vetoed += u32::from(is_vetoed);
    }
}
