//! The thread that asks a model: a frame of the question's tick from the world,
//! pictures, prompts, requests, and what they say together.

use std::rc::Rc;
use std::sync::mpsc::{Receiver, Sender, SyncSender, TryRecvError};
use std::time::Duration;

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use shm_config::config::{Config, View, Vlm};
use shm_config::message::{
    Camera, Foresight, Frame, FrameRequest, Header, Judge as JudgeKind, View as Seat,
};
use shm_config::services::Process;
use shm_config::wire::{Wire, WireError};
use shm_config::{Instant, Message};
use tokio::task::LocalSet;

use crate::model::{Asked, Asker};
use crate::ports::PicturePorts;
use crate::presentation::picture::{Photo, Picture, Proposals, Style, picture};
use crate::presentation::{Party, Prompt, Showing, combine, fixed_showing};
use crate::query::{Answer, Failure, Question, Ruling, Threaded};
use crate::record::{Asking, Evidence, Outlook};

/// From look to look at questions and frames; a model takes a hundred times as
/// long, and 200 looks a second cost well under a hundredth of a core.
const LOOK: Duration = Duration::from_millis(5);
/// How long a frame is waited for, ns. The world draws it within some ms, where
/// it has a camera at all.
const FRAME_NS: u64 = 1_000_000_000;
/// How long what the simulator foresees is waited for after the frame, ns: it
/// follows it at once, or there is none.
const FORESIGHT_NS: u64 = 200_000_000;

/// The judge of section `vlm`, on a thread of its own with ports of its own.
///
/// # Errors
/// When the configuration does not say whom to ask, or its key cannot be had.
pub fn model(
    config: &Config,
    evidence: Sender<Evidence>,
    clock: fn() -> Instant,
) -> Result<Threaded, crate::model::AskerError> {
    let asker = Asker::new(&config.vlm)?;
    let capacity = config.gate.in_flight as usize;
    let config = config.clone();
    let serve = move |questions: Receiver<Question>, rulings: SyncSender<(Question, Ruling)>| {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        let ports = Ports::open(&config);
        match (runtime, ports) {
            (Ok(runtime), Ok(ports)) => {
                let court = Rc::new(Court {
                    config,
                    asker,
                    clock,
                    rulings,
                    evidence,
                });
                let served = serve(court, ports, questions);
                runtime.block_on(LocalSet::new().run_until(served));
            }
            // The thread ends, and the docket says of every question that nobody
            // is there to answer it.
            (Err(error), _) => tracing::error!(%error, "the judge cannot start"),
            (_, Err(error)) => tracing::error!(%error, "the judge cannot join the run"),
        }
    };
    Ok(Threaded::served(JudgeKind::Vlm, capacity, Box::new(serve)))
}

/// Ports belong to one thread.
struct Ports {
    wire: PicturePorts,
    _member: Wire,
}

impl Ports {
    fn open(config: &Config) -> Result<Self, WireError> {
        let failed =
            |error: shm_config::run::InvalidRunName| WireError::port("run", error.to_string());
        let wire = process::join_as(&config.run.name.parse().map_err(failed)?, Process::Gate)?;
        Ok(Self {
            wire: PicturePorts::open(&wire)?,
            _member: wire,
        })
    }

    fn update_connections(&mut self) {
        self.wire.update_connections();
    }
}

struct Court {
    config: Config,
    asker: Asker,
    clock: fn() -> Instant,
    rulings: SyncSender<(Question, Ruling)>,
    evidence: Sender<Evidence>,
}

/// One question after the other gets its frame; then they are asked side by side.
async fn serve(court: Rc<Court>, mut ports: Ports, questions: Receiver<Question>) {
    loop {
        match questions.try_recv() {
            Ok(question) => {
                let begun = (court.clock)();
                let seen = ports.see(&question, &court).await;
                let court = court.clone();
                tokio::task::spawn_local(async move {
                    court.judge(&question, seen, begun).await;
                });
            }
            Err(TryRecvError::Empty) => {
                ports.update_connections();
                tokio::time::sleep(LOOK).await;
            }
            Err(TryRecvError::Disconnected) => return,
        }
    }
}

/// The question's scene, as the world drew it.
struct Seen {
    shot: Option<Shot>,
    foresight: Option<[Outlook; 2]>,
}

/// A frame, out of shared memory.
struct Shot {
    camera: Camera,
    width: u32,
    height: u32,
    rgb: Vec<u8>,
}

impl Shot {
    fn of(frame: &Frame) -> Self {
        Self {
            camera: frame.camera,
            width: frame.width,
            height: frame.height,
            rgb: frame.rgb().to_vec(),
        }
    }

    fn photo(&self) -> Photo<'_> {
        Photo {
            camera: &self.camera,
            width: self.width,
            height: self.height,
            rgb: &self.rgb,
        }
    }

    /// From where it is seen, whatever was asked for: MetaDrive has one view.
    fn view(&self) -> View {
        match self.camera.orthographic {
            0 => View::Ego,
            _ => View::TopDown,
        }
    }
}

impl Ports {
    /// Asks the world for the frame of the question's tick and waits for it.
    async fn see(&mut self, question: &Question, court: &Court) -> Seen {
        let vlm = &court.config.vlm;
        let header = question.observation.header;
        let mut request = FrameRequest {
            header: Header {
                tick: header.tick,
                taken_ns: header.taken_ns,
                episode: header.episode,
                ..Header::default()
            },
            view: match vlm.view {
                View::Ego => Seat::Ego,
                View::TopDown => Seat::TopDown,
            }
            .code(),
            width: vlm.width_px,
            height: vlm.height_px,
            proposals: [question.expert, question.policy],
            ..FrameRequest::default()
        };
        self.update_connections();
        self.wire.requests.send(&mut request);
        let mut until = (court.clock)().after_ns(FRAME_NS);
        let mut seen = Seen {
            shot: None,
            foresight: None,
        };
        let is_same = |other: &Header| (other.episode, other.tick) == question.key();
        while (court.clock)() < until && (seen.shot.is_none() || seen.foresight.is_none()) {
            self.update_connections();
            let shot = self.wire.frames.visit(|frame| {
                let fits = is_of(&frame.header, &header) && frame.check().is_ok();
                fits.then(|| Shot::of(frame))
            });
            if let Some(Some(shot)) = shot {
                seen.shot = Some(shot);
                until = (court.clock)().after_ns(FORESIGHT_NS);
            }
            let foresight = self.wire.foresights.newest(Message::check);
            let foresight = foresight.filter(|foresight| is_same(&foresight.header));
            seen.foresight = seen.foresight.or(foresight.as_ref().map(outlooks));
            tokio::time::sleep(LOOK).await;
        }
        seen
    }
}

/// The frame is of the question's scene: of its tick, or of one soon after where
/// the world draws what is now, as MetaDrive does.
fn is_of(frame: &Header, question: &Header) -> bool {
    frame.episode == question.episode
        && frame.tick >= question.tick
        && frame.taken_ns.saturating_sub(question.taken_ns) <= FRAME_NS
}

fn outlooks(foresight: &Foresight) -> [Outlook; 2] {
    let parties = [Party::Expert, Party::Policy];
    std::array::from_fn(|k| Outlook {
        party: parties[k],
        horizon_s: foresight.horizon_s,
        contact_s: foresight.outlooks[k].contact_s,
        out_s: foresight.outlooks[k].out_s,
    })
}

impl Court {
    async fn judge(&self, question: &Question, seen: Seen, begun: Instant) {
        let vlm = &self.config.vlm;
        let mut evidence = Evidence {
            key: question.key(),
            preset: vlm.prompt.word().into(),
            model: vlm.model_name().into(),
            foresight: seen.foresight,
            ..Evidence::default()
        };
        let answer = match &seen.shot {
            None => {
                evidence.fault = "no_frame".into();
                Answer::Failed(Failure::Unavailable)
            }
            Some(shot) => self.ask(question, shot, &mut evidence).await,
        };
        evidence.trouble = self.asker.trouble();
        evidence.latency_s = (self.clock)().since_ns(begun) as f64 / 1e9;
        let cost_usd = evidence.askings.iter().map(|asking| asking.cost_usd).sum();
        let ruling = Ruling::new(answer, cost_usd);
        // Evidence first: who hears the ruling finds it.
        let _ = self.evidence.send(evidence);
        let _ = self.rulings.try_send((*question, ruling));
    }

    async fn ask(&self, question: &Question, shot: &Shot, evidence: &mut Evidence) -> Answer {
        let vlm = &self.config.vlm;
        let showing = showing(vlm, self.config.gate.seed, question);
        let pictures = match self.pictures(question, shot, showing) {
            Ok(pictures) => pictures,
            Err(error) => {
                evidence.fault = format!("picture: {error}");
                return Answer::Failed(Failure::Unavailable);
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
            return Answer::Failed(fault.failure());
        }
        let answer = combine(&replies);
        if answer == Answer::Abstain {
            evidence.fault = "disagree".into();
        }
        answer
    }

    fn pictures(
        &self,
        question: &Question,
        shot: &Shot,
        showing: Showing,
    ) -> Result<Vec<(Showing, Picture)>, crate::presentation::picture::PictureError> {
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

/// Which path is the first, and in which colours: as the preset says, or at
/// random by the question alone, so that runs repeat.
fn showing(vlm: &Vlm, seed: u64, question: &Question) -> Showing {
    if let Some(showing) = fixed_showing(vlm.prompt) {
        return showing;
    }
    let (episode, tick) = question.key();
    let place = tick ^ (u64::from(episode) << 40);
    let mut random = SplitMix64::seed_from_u64(!seed ^ place.wrapping_mul(0x9e37_79b9));
    // The first number of neighbouring seeds is alike.
    let _ = random.next_u64();
    Showing::at_random(|count| ((random.next_u64() >> 33) as usize) % count)
}
