use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread;

use shm_config::Instant;
use shm_config::message::{Judge as JudgeKind, Step};

use super::{Answer, Failure, Judge, Question, Ruling};

/// Where questions wait for a judge. Never blocks: a judge that takes its time
/// does so somewhere else.
pub trait Docket {
    /// What kind of judge it is.
    fn kind(&self) -> JudgeKind;

    /// Puts a question; `false` when no more are taken now.
    fn put(&mut self, question: &Question) -> bool;

    /// A ruling that is there, with its question. `now` is on the run's clock.
    fn take(&mut self, now: Instant) -> Option<(Question, Ruling)>;

    /// Questions whose rulings a run in lockstep has to wait for.
    fn awaited(&self) -> usize;

    /// Whether this step is one to ask about, where the docket knows it better
    /// than the configured occasions.
    fn wants(&self, _step: &Step) -> Option<bool> {
        None
    }
}

/// A judge that answers at once, in the caller's thread.
pub struct AtOnce<J> {
    judge: J,
    ruling: Option<(Question, Ruling)>,
}

impl<J: Judge> AtOnce<J> {
    /// This judge.
    pub fn new(judge: J) -> Self {
        Self {
            judge,
            ruling: None,
        }
    }
}

impl<J: Judge> Docket for AtOnce<J> {
    fn kind(&self) -> JudgeKind {
        self.judge.kind()
    }

    fn put(&mut self, question: &Question) -> bool {
        self.ruling = Some((*question, self.judge.ask(question)));
        true
    }

    fn take(&mut self, _now: Instant) -> Option<(Question, Ruling)> {
        self.ruling.take()
    }

    fn awaited(&self) -> usize {
        usize::from(self.ruling.is_some())
    }
}

/// Whoever serves a docket from a thread of its own: takes questions, sends
/// rulings, several at once and in any order if it likes. Ends when either
/// channel does.
pub type Serve = dyn FnOnce(Receiver<Question>, SyncSender<(Question, Ruling)>) + Send;

/// A judge on a thread of its own, so that one that hangs holds up nobody.
pub struct Threaded {
    kind: JudgeKind,
    questions: SyncSender<Question>,
    rulings: Receiver<(Question, Ruling)>,
    pending: Vec<Question>,
    capacity: usize,
}

impl Threaded {
    /// A judge that answers one question at a time.
    pub fn new(mut judge: impl Judge + 'static) -> Self {
        let kind = judge.kind();
        Self::served(
            kind,
            1,
            Box::new(move |questions, rulings| {
                while let Ok(question) = questions.recv() {
                    let ruling = judge.ask(&question);
                    if rulings.send((question, ruling)).is_err() {
                        break;
                    }
                }
            }),
        )
    }

    /// A judge that has up to `capacity` questions at once.
    pub fn served(kind: JudgeKind, capacity: usize, serve: Box<Serve>) -> Self {
        let (questions, asked) = sync_channel(capacity);
        let (answered, rulings) = sync_channel(capacity);
        // Never joined: a judge that hangs for ever must not hold up the exit.
        thread::spawn(move || serve(asked, answered));
        Self {
            kind,
            questions,
            rulings,
            pending: Vec::with_capacity(capacity),
            capacity,
        }
    }
}

impl Docket for Threaded {
    fn kind(&self) -> JudgeKind {
        self.kind
    }

    fn put(&mut self, question: &Question) -> bool {
        if self.pending.len() == self.capacity {
            return false;
        }
        // A dead thread's questions are pending too: `take` says what became of
        // them.
        let _ = self.questions.try_send(*question);
        self.pending.push(*question);
        true
    }

    fn take(&mut self, _now: Instant) -> Option<(Question, Ruling)> {
        match self.rulings.try_recv() {
            Ok((question, ruling)) => {
                self.pending
                    .retain(|pending| pending.key() != question.key());
                Some((question, ruling))
            }
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                let question = self.pending.pop()?;
                Some((question, Ruling::failed(Failure::Unavailable)))
            }
        }
    }

    fn awaited(&self) -> usize {
        self.pending.len()
    }
}

/// Several judges and a quorum: an answer holds when so many give it.
pub struct Committee {
    jurors: Vec<Box<dyn Docket>>,
    quorum: usize,
    capacity: usize,
    cases: Vec<Case>,
}

/// A question that a committee has.
struct Case {
    question: Question,
    /// What each juror said; `None` for not yet.
    rulings: Vec<Option<Ruling>>,
}

impl Committee {
    /// These jurors; `quorum` is more than half of them, so that no two answers
    /// can both have it.
    pub fn new(jurors: Vec<Box<dyn Docket>>, quorum: usize, capacity: usize) -> Self {
        Self {
            jurors,
            quorum,
            capacity,
            cases: Vec::with_capacity(capacity),
        }
    }
}

impl Docket for Committee {
    fn kind(&self) -> JudgeKind {
        JudgeKind::Committee
    }

    fn put(&mut self, question: &Question) -> bool {
        if self.cases.len() == self.capacity {
            return false;
        }
        // Who is not free now takes no part in this one.
        let rulings = self
            .jurors
            .iter_mut()
            .map(|juror| match juror.put(question) {
                true => None,
                false => Some(Ruling::failed(Failure::Unavailable)),
            })
            .collect();
        self.cases.push(Case {
            question: *question,
            rulings,
        });
        true
    }

    fn take(&mut self, now: Instant) -> Option<(Question, Ruling)> {
        for (k, juror) in self.jurors.iter_mut().enumerate() {
            while let Some((question, ruling)) = juror.take(now) {
                let case = self
                    .cases
                    .iter_mut()
                    .find(|case| case.question.key() == question.key());
                if let Some(case) = case {
                    case.rulings[k] = Some(ruling);
                }
            }
        }
        let quorum = self.quorum;
        let decided = |case: &Case| agree(&case.rulings, quorum).is_some();
        let case = self.cases.swap_remove(self.cases.iter().position(decided)?);
        let answer = agree(&case.rulings, quorum)?;
        // What jurors who are still at it will cost is not known to this case.
        let cost_usd = case.rulings.iter().flatten().map(|r| r.cost_usd).sum();
        let mut ruling = Ruling::new(answer, cost_usd);
        for (vote, said) in ruling.votes.iter_mut().zip(&case.rulings) {
            *vote = said.map(|ruling| ruling.answer);
        }
        Some((case.question, ruling))
    }

    fn awaited(&self) -> usize {
        self.cases.len()
    }
}

/// What a committee says: `None` while the missing rulings may still decide it.
fn agree(rulings: &[Option<Ruling>], quorum: usize) -> Option<Answer> {
    let votes = |answer| {
        let agree = |ruling: &&Ruling| ruling.answer == answer;
        rulings.iter().flatten().filter(agree).count()
    };
    let missing = rulings.iter().filter(|ruling| ruling.is_none()).count();
    let sides = [Answer::Expert, Answer::Policy];
    if let Some(answer) = sides.into_iter().find(|&answer| votes(answer) >= quorum) {
        return Some(answer);
    }
    let is_open = sides
        .into_iter()
        .any(|answer| votes(answer) + missing >= quorum);
    (!is_open).then_some(Answer::Abstain)
}
