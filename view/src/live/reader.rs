//! Reads a living run from outside, as `./vlaps status` does, 20 times a second, and
//! survives its end and its return.
//!
//! It is one more reader of the run's services: it rings no bell, has no priority, and a
//! publisher never waits for it.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use shm_config::Message;
use shm_config::config::{self, Config};
use shm_config::message::Step;
use shm_config::run::{RunName, RunPaths};
use shm_config::services::{EPISODE_QUEUE, Process, STEP_QUEUE};
use shm_config::wire::{Subscriber, Wire};
use supervisor::cli::failure::Failure;
use supervisor::machine::memory::Memory;
use supervisor::machine::signals::pause;
use supervisor::run::leftovers::clean_run;
use supervisor::run::restarts;
use supervisor::run::selection::alive;
use supervisor::telemetry::judge;
use supervisor::telemetry::ports::Ports;
use supervisor::telemetry::process_tally::ProcessTally;
use supervisor::telemetry::tally::Tally;

use super::events::Detector;
use super::foxglove::{Board, Shown};
use super::hello::Hello;
use super::history::History;
use super::hub::{Hub, Moment};
use super::scene::Painter;
use super::status::{RunFolder, Status};

/// Stack of the thread that reads, which holds several whole messages. Compiled with less
/// optimisation it needs more than the 2 MB of a thread's default, and 4 MB are enough.
pub(super) const STACK_BYTES: usize = 8 << 20;
/// Time between two reads: the page's 20 Hz.
pub(super) const LOOK: Duration = Duration::from_millis(50);
/// Reads between two looks whether the supervisor lives: five a second, well within the
/// two seconds for which a new supervisor waits for the readers of the old run.
const ALIVE_LOOKS: u64 = 4;
/// Reads between two reports of the processes.
pub(super) const STATUS_LOOKS: u64 = 20;
/// Time between two searches for a run.
const SEARCH: Duration = Duration::from_millis(250);
/// The most pending messages of a latest-value service.
const PENDING_MAX: usize = 8;

/// Which run is shown.
#[derive(Debug, Clone)]
pub enum Wanted {
    /// The run of this name.
    Named(RunName),
    /// The one run of the current folder.
    OfThisFolder,
}

impl Wanted {
    /// The run and its supervisor, if it lives.
    ///
    /// # Errors
    /// When several runs of this folder live, or its folder cannot be read.
    pub fn find(&self) -> Result<Option<(RunPaths, u32)>, Failure> {
        let paths = match self {
            Self::Named(name) => Some(RunPaths::new(name.clone())),
            Self::OfThisFolder => of_this_folder()?,
        };
        Ok(paths.and_then(|paths| {
            let supervisor = paths.supervisor_pid()?;
            Some((paths, supervisor))
        }))
    }

    fn note(&self) -> String {
        match self {
            Self::Named(name) => {
                format!("run '{name}' is not running; ./vlaps up --run {name} starts it")
            }
            Self::OfThisFolder => "nothing runs here; ./vlaps up starts a run".into(),
        }
    }
}

/// The one set of the current folder, by the rule of `./vlaps down`; `None` when no set of
/// this folder runs.
fn of_this_folder() -> Result<Option<RunPaths>, Failure> {
    let here = std::env::current_dir().map_err(|error| {
        Failure::GivenUp(format!(
            "the current folder: {error}; name a run with --run"
        ))
    })?;
    let is_own = |paths: &RunPaths| {
        let origin = paths.origin();
        origin.is_some_and(|origin| origin.parent.is_none() && origin.folder.starts_with(&here))
    };
    let mut own: Vec<_> = alive()?.into_iter().filter(is_own).collect();
    if own.len() > 1 {
        let names: Vec<_> = own.iter().map(|run| run.name().to_string()).collect();
        let names = names.join(", ");
        return Err(Failure::Usage(format!(
            "several sets of this folder run: {names}; name one with --run NAME, or see them \
             with --all"
        )));
    }
    Ok(own.pop())
}

/// Where the reader puts what it has read.
#[derive(Debug, Clone, Default)]
pub struct Boards {
    /// For the page.
    pub hub: Arc<Hub>,
    /// For Foxglove, if it is wanted.
    pub foxglove: Option<Arc<Board>>,
}

/// Reads runs until it is told to stop.
pub fn read(wanted: &Wanted, boards: &Boards, stop: &AtomicBool) {
    let hub = &boards.hub;
    let mut told = None;
    while !stop.load(Ordering::Relaxed) {
        let outcome = match wanted.find() {
            Ok(Some((paths, supervisor))) => {
                let read = follow((&paths, supervisor), boards, stop);
                // If the run has ended meanwhile, this process has kept its files from
                // removal.
                if paths.supervisor_pid().is_none() {
                    let _ = clean_run(&paths);
                }
                match read {
                    Ok(()) => {
                        told = None;
                        Ok(())
                    }
                    failed => failed,
                }
            }
            Ok(None) => Err(Failure::GivenUp(wanted.note())),
            Err(failure) => Err(failure),
        };
        if let Err(failure) = outcome {
            let note = failure.to_string();
            // Told once: the page keeps it until a run comes.
            if told.as_ref() != Some(&note) {
                hub.begin(&Hello::waiting(note.clone()).json());
                told = Some(note);
            }
            pause(SEARCH);
        }
    }
}

/// Reads one run until its supervisor ends.
fn follow(
    (paths, supervisor): (&RunPaths, u32),
    boards: &Boards,
    stop: &AtomicBool,
) -> Result<(), Failure> {
    let hub = &boards.hub;
    let mut live = Live::open(paths, supervisor)?;
    let board = boards.foxglove.clone();
    live.shown = board.map(|board| Shown::new(board, &live.config));
    hub.begin(&Hello::live(&live.config, supervisor).json());
    for look in 0_u64.. {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        if look.is_multiple_of(ALIVE_LOOKS) && paths.supervisor_pid() != Some(supervisor) {
            break;
        }
        live.drain();
        let moment = live.moment(look.is_multiple_of(STATUS_LOOKS));
        hub.publish(moment);
        pause(LOOK);
    }
    Ok(())
}

/// A run that is being read.
pub(super) struct Live<'a> {
    pub(super) config: Config,
    paths: &'a RunPaths,
    supervisor: u32,
    ports: Ports,
    /// The membership: it ends after the ports.
    _wire: Wire,
    pub(super) tally: Tally,
    painter: Painter,
    pub(super) history: History,
    detector: Detector,
    folder: RunFolder,
    /// Shows the run to Foxglove, too.
    shown: Option<Shown>,
    step: Option<Box<Step>>,
    /// Whether the step came since the last moment.
    pub(super) is_new: bool,
}

impl<'a> Live<'a> {
    /// Joins a run as a reader.
    ///
    /// # Errors
    /// When it has another layout, is not ours, or is just starting or ending.
    pub(super) fn open(paths: &'a RunPaths, supervisor: u32) -> Result<Self, Failure> {
        let config = config::load(&paths.config_file()).map_err(|_| {
            let name = paths.name();
            Failure::GivenUp(format!("run '{name}' is just starting or ending"))
        })?;
        let wire = Wire::join(paths.name(), Process::Supervisor)?;
        wire.follow(supervisor)?;
        wire.await_named(Process::Supervisor, supervisor)?;
        // The supervisor writes down where the folder is: the name in the configuration
        // is relative to where it was started.
        let origin = paths.origin().map(|origin| origin.folder);
        let folder = origin.unwrap_or_else(|| Path::new(&config.run.folder).into());
        Ok(Self {
            ports: Ports::open(&wire)?,
            _wire: wire,
            painter: Painter::new(&config),
            folder: RunFolder::new(&folder),
            shown: None,
            config: Config {
                run: shm_config::config::Run {
                    folder: folder.to_string_lossy().into_owned(),
                    ..config.run.clone()
                },
                ..config
            },
            paths,
            supervisor,
            tally: Tally::default(),
            history: History::default(),
            detector: Detector::default(),
            step: None,
            is_new: false,
        })
    }

    /// Begins the course of the run again: its next sample names the driver, for a page that
    /// is opened now.
    pub(super) fn begin_course(&mut self) {
        self.history.forget_driver();
    }

    /// Takes all new messages in. Never blocks; bounded by the queues.
    pub(super) fn drain(&mut self) {
        let (tally, detector) = (&mut self.tally, &mut self.detector);
        for (process, port) in &mut self.ports.healths.0 {
            for health in pending(port, PENDING_MAX) {
                if tally.count_health(*process, &health).is_some() {
                    detector.health(*process, &health);
                    if let Some(shown) = &mut self.shown {
                        shown.note(*process, &health);
                    }
                }
            }
        }
        for (process, port) in &mut self.ports.timings.0 {
            for timing in pending(port, PENDING_MAX).filter(|timing| timing.check().is_ok()) {
                tally.count_timing(*process, timing);
            }
        }
        for progress in pending(&mut self.ports.progress, PENDING_MAX) {
            tally.count_progress(progress);
            if progress.check().is_ok() {
                detector.progress(&progress);
            }
        }
        for episode in pending(&mut self.ports.episodes, EPISODE_QUEUE) {
            tally.count_episode(episode);
            if episode.check().is_ok() {
                detector.episode(&episode);
            }
        }
        for status in pending(&mut self.ports.policies, PENDING_MAX) {
            tally.count_policy(status);
            if status.check().is_ok() {
                detector.policy(&status);
            }
        }
        self.drain_steps();
    }

    fn drain_steps(&mut self) {
        self.ports.steps.update_connections();
        for _ in 0..STEP_QUEUE {
            let (tally, detector, history) =
                (&mut self.tally, &mut self.detector, &mut self.history);
            let (kept, is_new) = (&mut self.step, &mut self.is_new);
            let read = self.ports.steps.visit(|step| {
                tally.count_step(step);
                if step.check().is_err() {
                    tally.refused += 1;
                    return;
                }
                detector.step(step);
                history.add(step);
                match kept {
                    Some(kept) => **kept = *step,
                    None => *kept = Some(Box::new(*step)),
                }
                *is_new = true;
            });
            if read.is_none() {
                return;
            }
        }
    }

    /// What is new since the last moment.
    pub(super) fn moment(&mut self, status_due: bool) -> Moment {
        let step = self.step.as_ref().filter(|_| self.is_new);
        // A step without an observation shows nothing.
        let drawn = step.filter(|step| step.observation_age_ns != u64::MAX);
        let scene = drawn.and_then(|step| {
            let scene = self.painter.scene(step);
            Some((scene.tick, serde_json::to_string(&scene).ok()?))
        });
        if let (Some(shown), Some(step)) = (&mut self.shown, step) {
            shown.step(step);
        }
        let sample = self.history.take();
        let moment = Moment {
            scene,
            sample: sample.and_then(|sample| serde_json::to_string(&sample).ok()),
            events: self.detector.take(),
            status: status_due.then(|| self.status()).flatten(),
            step: self.step.clone().filter(|_| self.is_new),
        };
        // The set's own counts are shown.
        self.detector.restarts.clear();
        self.is_new = false;
        moment
    }

    fn status(&mut self) -> Option<String> {
        for process in Process::ALL {
            let said = self.tally.process(*process).and_then(ProcessTally::newest);
            let pid = said.map(|health| health.header.producer);
            if let Some(memory) = pid.and_then(Memory::of) {
                self.tally.count_memory(*process, memory);
            }
        }
        let told = (
            &restarts::read(self.paths),
            judge::read(&self.config, self.supervisor),
        );
        let mut status = Status::new(&self.config, &self.tally, told, &mut self.folder);
        status.lost = self.ports.steps.lost();
        if let (Some(shown), Some(question)) = (&mut self.shown, &status.question) {
            shown.question(question, &self.folder.pictures());
        }
        serde_json::to_string(&status).ok()
    }
}

fn pending<M: Message>(port: &mut Subscriber<M>, most: usize) -> impl Iterator<Item = M> {
    port.update_connections();
    std::iter::from_fn(|| port.receive()).take(most)
}
