use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread;

use shm_config::Instant;
use shm_config::message::{Judge as JudgeKind, Step};

use super::{Answer, Failure, Judge, Question, QuestionId};

/// The queue between the advisor and a judge. It never blocks: a slow judge runs on its
/// own thread.
pub trait QueryQueue {
    /// What kind of judge it is.
    fn kind(&self) -> JudgeKind;

    /// Adds a question; `false` when the queue is full.
    fn put(&mut self, question: Question) -> bool;

    /// Takes an answer that has arrived. `now` is on the run's clock.
    fn take(&mut self, now: Instant) -> Option<Answer>;

    /// The number of questions whose answers a run in lockstep must wait for.
    fn awaited(&self) -> usize;

    /// Whether to ask about this step; `None` leaves it to the configured query policy.
    fn wants(&self, _step: &Step) -> Option<bool> {
        None
    }

    /// Pieces of evidence that follow each question; more are announced by a piece.
    fn pieces(&self) -> usize {
        usize::from(self.kind() == JudgeKind::Vlm)
    }

    /// What the answers that [`QueryQueue::take`] has not given have cost, US dollars.
    fn unheard_cost_usd(&self) -> f64 {
        0.0
    }
}

/// A judge that answers at once, on the caller's thread.
pub struct Immediate<J> {
    judge: J,
    answer: Option<Answer>,
}

impl<J: Judge> Immediate<J> {
    /// A queue to this judge.
    pub fn new(judge: J) -> Self {
        Self {
            judge,
            answer: None,
        }
    }
}

impl<J: Judge> QueryQueue for Immediate<J> {
    fn kind(&self) -> JudgeKind {
        self.judge.kind()
    }

    fn put(&mut self, question: Question) -> bool {
        self.answer = Some(self.judge.ask(&question));
        true
    }

    fn take(&mut self, _now: Instant) -> Option<Answer> {
        self.answer.take()
    }

    fn awaited(&self) -> usize {
        usize::from(self.answer.is_some())
    }
}

/// The body of a judge's thread. It receives questions and sends answers; several
/// questions may be open, and answers come in any order. It ends when either channel
/// closes.
pub type Serve = dyn FnOnce(Receiver<Question>, SyncSender<Answer>) + Send;

/// A judge on its own thread: a judge that hangs blocks nothing else.
pub struct Threaded {
    kind: JudgeKind,
    questions: SyncSender<Question>,
    answers: Receiver<Answer>,
    pending: Vec<QuestionId>,
    capacity: usize,
}

impl Threaded {
    /// A judge that answers one question at a time.
    pub fn new(mut judge: impl Judge + 'static) -> Self {
        let kind = judge.kind();
        Self::served(
            kind,
            1,
            Box::new(move |questions, answers| {
                while let Ok(question) = questions.recv() {
                    if answers.send(judge.ask(&question)).is_err() {
                        break;
                    }
                }
            }),
        )
    }

    /// A judge with up to `capacity` open questions.
    pub fn served(kind: JudgeKind, capacity: usize, serve: Box<Serve>) -> Self {
        let (questions, asked) = sync_channel(capacity);
        let (answered, answers) = sync_channel(capacity);
        // Never joined: a judge that hangs must not delay the exit.
        thread::spawn(move || serve(asked, answered));
        Self {
            kind,
            questions,
            answers,
            pending: Vec::with_capacity(capacity),
            capacity,
        }
    }
}

impl QueryQueue for Threaded {
    fn kind(&self) -> JudgeKind {
        self.kind
    }

    fn put(&mut self, question: Question) -> bool {
        if self.pending.len() == self.capacity {
            return false;
        }
        self.pending.push(question.id());
        // When the thread has died, `take` answers with a failure.
        let _ = self.questions.try_send(question);
        true
    }

    fn take(&mut self, _now: Instant) -> Option<Answer> {
        match self.answers.try_recv() {
            Ok(answer) => {
                let key = answer.question.key();
                self.pending.retain(|pending| pending.key() != key);
                Some(answer)
            }
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                let question = self.pending.pop()?;
                Some(Answer::failed(question, Failure::Unavailable))
            }
        }
    }

    fn awaited(&self) -> usize {
        self.pending.len()
    }
}
