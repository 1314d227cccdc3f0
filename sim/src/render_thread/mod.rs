//! Draws pictures on request, outside the tick's thread.
//!
//! The tick's thread only writes an action log, through a queue that never blocks
//! ([`action_log`]). The render thread has no privileges and its own ports. It reads
//! requests, drives a [`Replica`] of the world to the requested tick, bit by bit, draws
//! it, and computes what would follow if either proposal were held. Without requests it
//! only empties the queue. A picture that cannot be drawn is not sent; the requester's
//! wait ends by its own limit.

mod action_log;
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
pub use action_log::{ActionLog, EpisodeLog, LogWriter, Move, Seen, action_log};
pub use replica::{HORIZON_S, Replica, outlook};

/// Interval at which requests are polled. A request waits half of it on average, little
/// compared with the seconds that a model takes to answer.
const LOOK: Duration = Duration::from_millis(5);

/// The handle of the render thread.
pub struct RenderThread {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl RenderThread {
    /// Starts the thread and returns the writing end of its log. Call it before the
    /// process applies its real-time privileges, which the thread must not inherit.
    ///
    /// # Errors
    /// When the system refuses a thread, or its ports cannot be opened.
    pub fn start(config: &Config) -> Result<(RenderThread, LogWriter), SetUpError> {
        let (writer, log) = action_log();
        let stop = Arc::new(AtomicBool::new(false));
        let (begin, begun) = channel();
        let (ending, config) = (stop.clone(), config.clone());
        let own = |what: String| SetUpError::Own(format!("the render thread: {what}"));
        let thread = thread::Builder::new()
            .name("render_thread".into())
            .spawn(move || work(config, log, &ending, &begin))
            .map_err(|error| own(error.to_string()))?;
        let render_thread = RenderThread {
            stop,
            thread: Some(thread),
        };
        match begun.recv() {
            Ok(Ok(())) => Ok((render_thread, writer)),
            Ok(Err(error)) => Err(error),
            Err(_) => Err(own("it panicked".into())),
        }
    }
}

impl Drop for RenderThread {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            let _ = thread.join();
        }
    }
}

fn work(config: Config, log: ActionLog, stop: &AtomicBool, begin: &Sender<Result<(), SetUpError>>) {
    let mut worker = match Worker::open(config, log) {
        Ok(worker) => worker,
        Err(error) => return drop(begin.send(Err(error))),
    };
    let _ = begin.send(Ok(()));
    while !stop.load(Ordering::Relaxed) {
        worker.requests.update_connections();
        if let Some(request) = worker.requests.requests.newest(Message::check) {
            worker.answer(&request);
        }
        worker.log.drain();
        thread::park_timeout(LOOK);
    }
    let Worker {
        taken, declined, ..
    } = worker;
    if taken + declined > 0 {
        tracing::info!(taken, declined, "pictures");
    }
}

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
enum Declined {
    #[error("the request is invalid: {0}")]
    Request(#[from] shm_config::message::Refusal),
    #[error("the action log does not hold that tick, or no longer")]
    Gone,
    #[error(transparent)]
    World(#[from] crate::WorldError),
    #[error("no memory for the picture")]
    Memory,
    #[error(transparent)]
    Wire(#[from] WireError),
}

/// The state of the thread.
struct Worker {
    config: Config,
    log: ActionLog,
    requests: RequestPorts,
    /// Opened for the first picture, because their shared memory is large.
    answers: Option<AnswerPorts>,
    /// Made for the first picture.
    replica: Option<Replica>,
    renderer: Renderer,
    taken: u64,
    declined: u64,
    wire: Wire,
}

impl Worker {
    fn open(config: Config, log: ActionLog) -> Result<Worker, SetUpError> {
        let wire = Wire::join(&config.run.name.parse()?, Process::World)?;
        Ok(Worker {
            requests: RequestPorts::open(&wire)?,
            config,
            log,
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
        // All ticks that can be requested are in the queue by now.
        self.log.drain();
        let episode_log = self.log.episode(request.header.episode);
        let episode_log = episode_log.ok_or(Declined::Gone)?;
        let replica = match &mut self.replica {
            Some(replica) => replica,
            none => none.insert(Replica::new(WorldConfig::from(&self.config))?),
        };
        let renderer = &mut self.renderer;
        let reached = replica.reach(episode_log, &request.header, |world| renderer.begin(world))?;
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
            episode: episode_log.episode,
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
