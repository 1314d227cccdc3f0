//! Pictures on demand, off the tick's thread.
//!
//! The tick's thread only tells what it did, through a queue that never blocks
//! ([`film`]). A thread without its privileges, with ports of its own, looks for
//! requests, drives a [`Replica`] to the tick that is asked for, which is the same
//! world bit by bit, draws it and tells what would come of both proposals there. As
//! long as nothing is asked it only empties the queue. A picture that cannot be drawn is
//! not sent: the wait for it ends by itself.

mod film;
mod replica;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use runtime::SetUpError;
use shm_config::Message;
use shm_config::config::Config;
use shm_config::message::{Foresight, FrameRequest, Header};
use shm_config::services::Process;
use shm_config::wire::{Wire, WireError};

use crate::WorldConfig;
use crate::ports::{AnswerPorts, RequestPorts};
use crate::render::{Renderer, Shot};
pub use film::{Film, Move, Recorder, Reel, Seen, film};
pub use replica::{HORIZON_S, Replica, outlook};

/// From look to look at requests. One waits half of it on average, little beside
/// the seconds that a model takes to answer.
const LOOK: Duration = Duration::from_millis(5);

/// The thread, as the process that started it sees it.
pub struct Photographer {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Photographer {
    /// Starts the thread, and gives the end of the film to tell it by. Before the
    /// process applies its real-time privileges: the thread must not inherit them.
    ///
    /// # Errors
    /// When the system gives no thread, or its ports cannot be opened.
    pub fn start(config: &Config) -> Result<(Photographer, Recorder), SetUpError> {
        let (recorder, film) = film();
        let stop = Arc::new(AtomicBool::new(false));
        let (begin, begun) = channel();
        let (ending, config) = (stop.clone(), config.clone());
        let own = |what: String| SetUpError::Own(format!("the photographer: {what}"));
        let thread = thread::Builder::new()
            .name("photographer".into())
            .spawn(move || work(config, film, &ending, &begin))
            .map_err(|error| own(error.to_string()))?;
        let photographer = Photographer {
            stop,
            thread: Some(thread),
        };
        match begun.recv() {
            Ok(Ok(())) => Ok((photographer, recorder)),
            Ok(Err(error)) => Err(error),
            Err(_) => Err(own("its thread died".into())),
        }
    }
}

impl Drop for Photographer {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            let _ = thread.join();
        }
    }
}

fn work(config: Config, film: Film, stop: &AtomicBool, begin: &Sender<Result<(), SetUpError>>) {
    let mut studio = match Studio::open(config, film) {
        Ok(studio) => studio,
        Err(error) => return drop(begin.send(Err(error))),
    };
    let _ = begin.send(Ok(()));
    while !stop.load(Ordering::Relaxed) {
        studio.requests.update_connections();
        if let Some(request) = studio.requests.requests.newest(Message::check) {
            studio.answer(&request);
        }
        studio.film.develop();
        thread::park_timeout(LOOK);
    }
    let Studio {
        taken, declined, ..
    } = studio;
    if taken + declined > 0 {
        tracing::info!(taken, declined, "pictures");
    }
}

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
enum Declined {
    #[error("the request is none: {0}")]
    Request(#[from] shm_config::message::Refusal),
    #[error("that tick is not, or no longer, on the film")]
    Gone,
    #[error(transparent)]
    World(#[from] crate::WorldError),
    #[error("no memory for the picture")]
    Memory,
    #[error(transparent)]
    Wire(#[from] WireError),
}

/// What the thread works with.
struct Studio {
    config: Config,
    film: Film,
    requests: RequestPorts,
    /// Opened with the first picture: their shared memory is large.
    answers: Option<AnswerPorts>,
    /// Made for the first picture.
    replica: Option<Replica>,
    renderer: Renderer,
    taken: u64,
    declined: u64,
    wire: Wire,
}

impl Studio {
    fn open(config: Config, film: Film) -> Result<Studio, SetUpError> {
        let wire = Wire::join(&config.run.name.parse()?, Process::World)?;
        Ok(Studio {
            requests: RequestPorts::open(&wire)?,
            config,
            film,
            answers: None,
            replica: None,
            renderer: Renderer::default(),
            taken: 0,
            declined: 0,
            wire,
        })
    }

    fn answer(&mut self, request: &FrameRequest) {
        let Header { tick, episode, .. } = request.header;
        match self.take(request) {
            Ok(()) => self.taken += 1,
            Err(why) => {
                self.declined += 1;
                let declined = self.declined;
                match why {
                    Declined::Request(_) | Declined::Gone => {
                        tracing::debug!(tick, episode, declined, %why, "no picture");
                    }
                    Declined::World(_) | Declined::Memory | Declined::Wire(_) => {
                        tracing::warn!(tick, episode, declined, %why, "no picture");
                    }
                }
            }
        }
    }

    fn take(&mut self, request: &FrameRequest) -> Result<(), Declined> {
        request.check()?;
        // Whatever can be asked for is in the queue by now.
        self.film.develop();
        let reel = self.film.reel(request.header.episode);
        let reel = reel.ok_or(Declined::Gone)?;
        let replica = match &mut self.replica {
            Some(replica) => replica,
            none => none.insert(Replica::new(WorldConfig::from(&self.config.world))?),
        };
        let renderer = &mut self.renderer;
        let reached = replica.reach(reel, &request.header, |world| renderer.begin(world))?;
        let (world, seen) = reached.ok_or(Declined::Gone)?;
        let shot = Shot {
            view: request.view(),
            size_px: request.size_px(),
            passed: seen.passed,
        };
        let picture = renderer.draw(world, &shot).ok_or(Declined::Memory)?;
        let answers = match &mut self.answers {
            Some(answers) => answers,
            none => none.insert(AnswerPorts::open(&self.wire)?),
        };
        let header = Header {
            tick: seen.tick,
            taken_ns: seen.taken_ns,
            episode: reel.episode,
            ..Header::default()
        };
        answers.update_connections();
        answers
            .frames
            .show(header, picture.camera, picture.size_px[0], picture.rgb);
        if let Some(actions) = request.actions() {
            let mut foresight = Foresight {
                header,
                horizon_s: HORIZON_S,
                outlooks: actions.map(|action| outlook(world, action)),
            };
            answers.foresights.send(&mut foresight);
        }
        Ok(())
    }
}
