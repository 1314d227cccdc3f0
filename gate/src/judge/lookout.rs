//! The thread that asks the world what would follow, where no model is shown a picture.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, sync_channel};
use std::thread;

use shm_config::Instant;
use shm_config::config::{Config, View, Vlm};
use shm_config::message::{FRAME_SIDES_PX, Judge as JudgeKind, Step};

use super::frames::Frames;
use crate::query::{Answer, QueryQueue, Question};
use crate::record::Evidence;

/// Questions that may wait for the world. A further one has no foresight in its record.
const WAITING_MAX: usize = 64;

/// Asks the world, on a thread of its own, what would follow if either proposal of a
/// question were held. What the world says is for the record alone.
pub struct Lookout {
    questions: SyncSender<Question>,
    evidence: Sender<Evidence>,
    state: Arc<State>,
}

#[derive(Default)]
struct State {
    /// Questions that the world has not answered yet.
    open: AtomicUsize,
    /// The thread has ended: nothing more comes.
    is_over: AtomicBool,
}

/// Marks the end of the thread, also by a panic.
struct Ending(Arc<State>);

impl Drop for Ending {
    fn drop(&mut self) {
        self.0.is_over.store(true, Ordering::Release);
    }
}

impl Lookout {
    /// Starts the thread; it joins the run with ports of its own.
    pub fn start(config: &Config, evidence: Sender<Evidence>, clock: fn() -> Instant) -> Self {
        let (questions, asked) = sync_channel(WAITING_MAX);
        let state = Arc::new(State::default());
        let ending = Ending(state.clone());
        let (config, sent) = (config.clone(), evidence.clone());
        // Never joined: a world that hangs must not delay the exit.
        thread::spawn(move || serve(&config, &asked, &sent, clock, &ending.0));
        Self {
            questions,
            evidence,
            state,
        }
    }

    /// Asks about a question. One piece of evidence follows, empty when the world gives no
    /// answer.
    pub fn look(&self, question: &Question) {
        self.state.open.fetch_add(1, Ordering::AcqRel);
        if self.questions.try_send(question.clone()).is_err() {
            self.state.open.fetch_sub(1, Ordering::AcqRel);
            let _ = self.evidence.send(Evidence {
                key: question.id().key(),
                ..Evidence::default()
            });
        }
    }

    /// Questions that a run in lockstep has to wait for.
    pub fn open(&self) -> usize {
        match self.state.is_over.load(Ordering::Acquire) {
            true => 0,
            false => self.state.open.load(Ordering::Acquire),
        }
    }
}

fn serve(
    config: &Config,
    questions: &Receiver<Question>,
    evidence: &Sender<Evidence>,
    clock: fn() -> Instant,
    state: &State,
) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    let (runtime, mut frames) = match (runtime, Frames::open(config)) {
        (Ok(runtime), Ok(frames)) => (runtime, frames),
        (Err(error), _) => return tracing::error!(%error, "no foresight"),
        (_, Err(error)) => return tracing::error!(%error, "no foresight"),
    };
    // The picture is not used: the smallest one.
    let vlm = Vlm {
        view: View::TopDown,
        width_px: *FRAME_SIDES_PX.start(),
        height_px: *FRAME_SIDES_PX.start(),
        ..config.vlm.clone()
    };
    while let Ok(question) = questions.recv() {
        let scene = runtime.block_on(frames.see(&question, &vlm, clock));
        let sent = evidence.send(Evidence {
            key: question.id().key(),
            foresight: scene.foresight,
            ..Evidence::default()
        });
        state.open.fetch_sub(1, Ordering::AcqRel);
        if sent.is_err() {
            return;
        }
    }
}

/// A judge that sees no picture, with the world's foresight in the record.
pub struct Foreseen {
    queue: Box<dyn QueryQueue>,
    lookout: Lookout,
}

impl Foreseen {
    /// Adds the foresight to the questions of this queue.
    pub fn new(queue: Box<dyn QueryQueue>, lookout: Lookout) -> Self {
        Self { queue, lookout }
    }
}

impl QueryQueue for Foreseen {
    fn kind(&self) -> JudgeKind {
        self.queue.kind()
    }

    fn put(&mut self, question: Question) -> bool {
        let is_taken = self.queue.put(question.clone());
        if is_taken {
            self.lookout.look(&question);
        }
        is_taken
    }

    fn take(&mut self, now: Instant) -> Option<Answer> {
        self.queue.take(now)
    }

    fn awaited(&self) -> usize {
        self.queue.awaited() + self.lookout.open()
    }

    fn wants(&self, step: &Step) -> Option<bool> {
        self.queue.wants(step)
    }

    fn pieces(&self) -> usize {
        self.queue.pieces() + 1
    }

    fn unheard_cost_usd(&self) -> f64 {
        self.queue.unheard_cost_usd()
    }
}
