//! The gate's advice, recomputed with the shipped advisor from the recorded steps.
//!
//! A judge of exact geometry is asked again. A model's answers are taken from the advice:
//! what follows from them is recomputed, hysteresis and expiry included.

use std::cell::RefCell;
use std::collections::{HashMap, VecDeque};
use std::rc::Rc;

use gate::advice::Advisor;
use gate::judge::{FaultyJudge, Rules};
use gate::query::{Answer, Immediate, QueryQueue, Question, QuestionId};
use shm_config::Instant;
use shm_config::config::{Config, GateMode};
use shm_config::message::{Advice, Judge as JudgeKind, Message, Step};
use shm_config::services::Process;

use super::findings::{Findings, Found};
use super::messages::{Stretch, taken};

const PROCESS: Process = Process::Gate;

/// Answers that are taken from the advice.
type Told = Rc<RefCell<VecDeque<Answer>>>;

/// A queue to a judge whose answers were recorded.
struct Recorded {
    kind: JudgeKind,
    told: Told,
}

impl Recorded {
    fn new(kind: JudgeKind, told: &Told) -> Self {
        Self {
            kind,
            told: told.clone(),
        }
    }
}

impl QueryQueue for Recorded {
    fn kind(&self) -> JudgeKind {
        self.kind
    }

    fn put(&mut self, _: Question) -> bool {
        true
    }

    fn take(&mut self, _: Instant) -> Option<Answer> {
        self.told.borrow_mut().pop_front()
    }

    fn awaited(&self) -> usize {
        0
    }
}

/// One gate process.
struct Living {
    advisor: Advisor,
    told: Told,
    last: Advice,
}

/// Recomputes the gate's advice.
pub struct Counsel {
    config: Config,
    /// The gates that began within the recording, by process.
    living: HashMap<u32, Living>,
}

impl Counsel {
    /// Of a run of this configuration.
    pub fn new(config: &Config) -> Self {
        Self {
            config: config.clone(),
            living: HashMap::new(),
        }
    }

    /// Recomputes the advice of a stretch from this tick on.
    pub fn check(&mut self, stretch: &Stretch, from: u64, findings: &mut Findings) {
        for recorded in &stretch.now.advice.all {
            let is_wanted = recorded.header.tick >= from;
            match self.again(stretch, recorded) {
                None if is_wanted => findings.unknown(PROCESS),
                Some(again) if is_wanted => {
                    findings.count(PROCESS, 1);
                    let pair = (recorded, &again);
                    let found = Found::in_message(PROCESS, stretch.number, "advice", pair);
                    findings.add(PROCESS, found);
                }
                None | Some(_) => {}
            }
        }
    }

    /// The advice on the step that a recorded one is about; `None` where the step or the
    /// beginning of the gate is not recorded.
    fn again(&mut self, stretch: &Stretch, recorded: &Advice) -> Option<Advice> {
        let header = recorded.header;
        if header.sequence == 1 {
            self.living
                .insert(header.producer, Living::new(&self.config));
        }
        let at = taken(&header);
        let step = stretch.find(|messages| messages.steps.at(at));
        let Some(step) = step.filter(|step| step.check().is_ok()) else {
            // What it learned there is missing from then on.
            self.living.remove(&header.producer);
            return None;
        };
        let living = self.living.get_mut(&header.producer)?;
        if living.last.header.sequence.wrapping_add(1) != header.sequence {
            self.living.remove(&header.producer);
            return None;
        }
        let mut again = living.consider(step, recorded, self.config.gate.mode);
        again.header.sequence = header.sequence;
        again.header.producer = header.producer;
        living.last = *recorded;
        Some(again)
    }
}

impl Living {
    fn new(config: &Config) -> Self {
        let told = Told::default();
        let queue: Box<dyn QueryQueue> = match config.gate.mode {
            GateMode::Vlm | GateMode::Paper => Box::new(Recorded::new(JudgeKind::Vlm, &told)),
            GateMode::Distilled => Box::new(Recorded::new(JudgeKind::Distilled, &told)),
            GateMode::Replay => Box::new(Recorded::new(JudgeKind::Recorded, &told)),
            GateMode::Rules
            | GateMode::Expert
            | GateMode::Policy
            | GateMode::Human
            | GateMode::Takeover => {
                let rules = Immediate::new(Rules::new(config.vehicle, config.safety));
                match config.faulty_judge.is_active() {
                    true => Box::new(FaultyJudge::new(&config.faulty_judge, Box::new(rules))),
                    false => Box::new(rules),
                }
            }
        };
        Self {
            advisor: Advisor::new(&config.gate, queue),
            told,
            last: Advice::default(),
        }
    }

    fn consider(&mut self, step: &Step, recorded: &Advice, mode: GateMode) -> Advice {
        let now = Instant(recorded.considered_ns);
        self.advisor.ask(step);
        let is_model = matches!(
            mode,
            GateMode::Vlm | GateMode::Paper | GateMode::Distilled | GateMode::Replay
        );
        if is_model && recorded.answers != self.last.answers {
            self.told.borrow_mut().push_back(answer(recorded));
        }
        self.advisor.hear(now);
        self.advisor.advise(now)
    }
}

/// The answer that a model gave before this advice.
fn answer(recorded: &Advice) -> Answer {
    let decides = recorded.question_taken_ns == recorded.label_from_ns
        && recorded.answered_ns == recorded.considered_ns;
    let question = QuestionId {
        // An answer about another episode decides nothing.
        episode: match decides {
            true => recorded.header.episode,
            false => recorded.header.episode.wrapping_sub(1),
        },
        tick: recorded.question_tick,
        taken: Instant(recorded.label_from_ns),
    };
    Answer::free(question, recorded.label())
}
