//! The thread that asks a model: it gets the frame of the question's tick from the
//! world, makes pictures and prompts, sends requests, and combines the replies to an
//! answer.

use std::rc::Rc;
use std::sync::mpsc::{Receiver, Sender, SyncSender, TryRecvError};
use std::time::Duration;

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use shm_config::Instant;
use shm_config::config::{Config, View, Vlm};
use shm_config::message::{Judge as JudgeKind, Preference};
use tokio::task::LocalSet;

use super::frames::{Frames, POLL, Scene, Shot};
use crate::model::{Asked, Asker, AskerError};
use crate::presentation::picture::{Picture, PictureError, Proposals, Style, picture};
use crate::presentation::{Prompt, Showing, combine, fixed_showing};
use crate::query::{Answer, Failure, Question, QuestionId, Threaded};
use crate::record::{Asking, Evidence};

/// The judge of section `vlm`, on its own thread with its own ports.
///
/// # Errors
/// When the configuration names no server or model, or the key cannot be read.
pub fn open(
    config: &Config,
    evidence: Sender<Evidence>,
    clock: fn() -> Instant,
) -> Result<Threaded, AskerError> {
    let asker = Asker::new(&config.vlm)?;
    let capacity = config.gate.in_flight as usize;
    let config = config.clone();
    let serve = move |questions: Receiver<Question>, answers: SyncSender<Answer>| {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        let frames = Frames::open(&config);
        match (runtime, frames) {
            (Ok(runtime), Ok(frames)) => {
                let worker = Rc::new(Worker {
                    config,
                    asker,
                    clock,
                    answers,
                    evidence,
                });
                let served = serve(worker, frames, questions);
                runtime.block_on(LocalSet::new().run_until(served));
            }
            // The thread ends, and the queue then answers every question with a
            // failure.
            (Err(error), _) => tracing::error!(%error, "the judge cannot start"),
            (_, Err(error)) => tracing::error!(%error, "the judge cannot join the run"),
        }
    };
    Ok(Threaded::served(JudgeKind::Vlm, capacity, Box::new(serve)))
}

/// What all questions to the model share.
struct Worker {
    config: Config,
    asker: Asker,
    clock: fn() -> Instant,
    answers: SyncSender<Answer>,
    evidence: Sender<Evidence>,
}

/// Fetches the frames one question after the other, and asks the questions
/// concurrently.
async fn serve(worker: Rc<Worker>, mut frames: Frames, questions: Receiver<Question>) {
    loop {
        match questions.try_recv() {
            Ok(question) => {
                let begun = (worker.clock)();
                let vlm = &worker.config.vlm;
                let scene = frames.see(&question, vlm, worker.clock).await;
                let worker = worker.clone();
                tokio::task::spawn_local(async move {
                    worker.judge(&question, scene, begun).await;
                });
            }
            Err(TryRecvError::Empty) => {
                frames.update_connections();
                tokio::time::sleep(POLL).await;
            }
            Err(TryRecvError::Disconnected) => return,
        }
    }
}

impl Worker {
    async fn judge(&self, question: &Question, scene: Scene, begun: Instant) {
        let vlm = &self.config.vlm;
        let mut evidence = Evidence {
            key: question.id().key(),
            preset: vlm.prompt.word().into(),
            model: vlm.model_name().into(),
            foresight: scene.foresight,
            ..Evidence::default()
        };
        let preference = match &scene.shot {
            None => {
                evidence.fault = "no_frame".into();
                Err(Failure::Unavailable)
            }
            Some(shot) => self.ask(question, shot, &mut evidence).await,
        };
        evidence.trouble = self.asker.trouble();
        evidence.latency_s = (self.clock)().since_ns(begun) as f64 / 1e9;
        let cost_usd = evidence.askings.iter().map(|asking| asking.cost_usd).sum();
        // The evidence is sent first, so that it is there when the answer is heard.
        let _ = self.evidence.send(evidence);
        let _ = self.answers.try_send(Answer {
            question: question.id(),
            preference,
            cost_usd,
        });
    }

    async fn ask(
        &self,
        question: &Question,
        shot: &Shot,
        evidence: &mut Evidence,
    ) -> Result<Preference, Failure> {
        let vlm = &self.config.vlm;
        let showing = showing(vlm, question.id());
        let pictures = match self.pictures(question, shot, showing) {
            Ok(pictures) => pictures,
            Err(error) => {
                evidence.fault = format!("picture: {error}");
                return Err(Failure::Unavailable);
            }
        };
        let view = shot.view();
        let asked = match pictures.as_slice() {
            [(first, picture), (second, swapped)] => {
                let (first, second) = tokio::join!(
                    self.show(*first, (view, picture)),
                    self.show(*second, (view, swapped))
                );
                vec![first, second]
            }
            [(first, picture)] => vec![self.show(*first, (view, picture)).await],
            _ => Vec::new(),
        };
        let fault = asked.iter().find_map(|(_, asked)| asked.reply.err());
        let replies = asked.iter().filter_map(|(prompt, asked)| {
            let (reply, _) = asked.reply.ok()?;
            Some((prompt.showing, reply))
        });
        let replies: Vec<_> = replies.collect();
        let kept = asked
            .iter()
            .map(|(prompt, asked)| Asking::new(prompt, asked));
        evidence.askings = kept.collect();
        evidence.pictures = pictures.into_iter().map(|(_, picture)| picture).collect();
        if let Some(fault) = fault {
            evidence.fault = fault.word().into();
            return Err(fault.failure());
        }
        let preference = combine(&replies);
        if preference == Preference::Abstain {
            evidence.fault = "disagree".into();
        }
        Ok(preference)
    }

    fn pictures(
        &self,
        question: &Question,
        shot: &Shot,
        showing: Showing,
    ) -> Result<Vec<(Showing, Picture)>, PictureError> {
        let vlm = &self.config.vlm;
        let style = Style::of(vlm);
        let proposals = Proposals::of(question, &self.config.vehicle)?;
        let mut showings = vec![showing];
        if vlm.ask_twice {
            showings.push(showing.swapped());
        }
        showings
            .into_iter()
            .map(|showing| Ok((showing, picture(shot.photo(), &proposals, showing, &style)?)))
            .collect()
    }

    async fn show(&self, showing: Showing, (view, picture): (View, &Picture)) -> (Prompt, Asked) {
        let vlm = &self.config.vlm;
        let prompt = Prompt::new(vlm.prompt, showing, view, vlm.horizon_s);
        let deadline = Duration::from_secs_f64(vlm.deadline_s);
        let asked = self.asker.ask(&prompt, picture, deadline).await;
        (prompt, asked)
    }
}

/// Which path is the first, and in which colours: as the preset says, or drawn from the
/// question alone, so that runs repeat.
fn showing(vlm: &Vlm, question: QuestionId) -> Showing {
    if let Some(showing) = fixed_showing(vlm.prompt) {
        return showing;
    }
    let mut random = SplitMix64::seed_from_u64(!question.seed());
    // Neighbouring seeds give similar first numbers, so the first is skipped.
    let _ = random.next_u64();
    Showing::at_random(|count| ((random.next_u64() >> 33) as usize) % count)
}
