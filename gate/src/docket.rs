use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::thread;

use shm_config::message::Judge as JudgeKind;

use crate::{Answer, Failure, Judge, Question, Ruling};

/// Where questions wait for a judge: at once in the caller's thread, or on a
/// thread of the judge's own, so that a judge that hangs holds up nobody.
pub struct Docket {
    kind: JudgeKind,
    court: Court,
}

enum Court {
    Immediate(Box<dyn Judge>, Option<(Question, Ruling)>),
    Threaded {
        questions: SyncSender<Question>,
        rulings: Receiver<(Question, Ruling)>,
        pending: Option<Question>,
    },
}

impl Docket {
    /// A judge that answers at once, in the caller's thread: deterministic in
    /// lockstep.
    pub fn immediate(judge: impl Judge + 'static) -> Self {
        Self {
            kind: judge.kind(),
            court: Court::Immediate(Box::new(judge), None),
        }
    }

    /// A judge with a thread of its own, one question at a time.
    pub fn threaded(mut judge: impl Judge + 'static) -> Self {
        let kind = judge.kind();
        let (questions, asked) = sync_channel::<Question>(1);
        let (answered, rulings) = sync_channel(1);
        // Never joined: a judge that hangs for ever must not hold up the exit.
        thread::spawn(move || {
            while let Ok(question) = asked.recv() {
                let ruling = judge.ask(&question);
                if answered.send((question, ruling)).is_err() {
                    break;
                }
            }
        });
        Self {
            kind,
            court: Court::Threaded {
                questions,
                rulings,
                pending: None,
            },
        }
    }

    /// What kind of judge it is.
    pub fn kind(&self) -> JudgeKind {
        self.kind
    }

    /// Puts a question; `false` when one is still pending.
    pub fn put(&mut self, question: Question) -> bool {
        match &mut self.court {
            Court::Immediate(judge, ruling) => {
                *ruling = Some((question, judge.ask(&question)));
                true
            }
            Court::Threaded {
                questions, pending, ..
            } => {
                if pending.is_some() {
                    return false;
                }
                let put = match questions.try_send(question) {
                    Ok(()) | Err(TrySendError::Disconnected(_)) => true,
                    Err(TrySendError::Full(_)) => false,
                };
                *pending = put.then_some(question);
                put
            }
        }
    }

    /// The ruling, once it is there, with its question. A judge whose thread has
    /// died is unavailable.
    pub fn take(&mut self) -> Option<(Question, Ruling)> {
        match &mut self.court {
            Court::Immediate(_, ruling) => ruling.take(),
            Court::Threaded {
                rulings, pending, ..
            } => {
                let ruled = match rulings.try_recv() {
                    Ok(ruled) => Some(ruled),
                    Err(TryRecvError::Empty) => None,
                    Err(TryRecvError::Disconnected) => pending.map(|question| {
                        let ruling = Ruling {
                            answer: Answer::Failed(Failure::Unavailable),
                            cost_usd: 0.0,
                        };
                        (question, ruling)
                    }),
                };
                if ruled.is_some() {
                    *pending = None;
                }
                ruled
            }
        }
    }
}
