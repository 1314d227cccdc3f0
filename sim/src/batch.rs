//! Many worlds at once, on one thread or several, with the same bits.
//!
//! Worlds are dealt to shards, one for each thread; a shard is locked by its
//! thread while it steps and by the caller between steps. Nothing is shared
//! between worlds, so the number of threads cannot change a result.

use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use shm_config::message::{Observation, Outcome};
use vehicle::Action;

use crate::config::{WorldConfig, WorldError};
use crate::world::{StepOutcome, World};

/// What happens to a world whose episode has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AfterEnd {
    /// It stays as it is until it is reset.
    Stay,
    /// Right after the tick that ended it, it begins the episode of its seed
    /// plus this stride. The outcome of the tick is still reported; the
    /// observation is the first of the new episode.
    Restart {
        /// Added to the seed; the number of worlds keeps their seeds apart.
        stride: u64,
    },
}

/// How many worlds, and how they are run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BatchConfig {
    /// Number of worlds.
    pub worlds: NonZeroUsize,
    /// Number of threads; one means the caller's own.
    pub threads: NonZeroUsize,
    /// What follows the end of an episode.
    pub after_end: AfterEnd,
}

/// One world of a batch, with room for what goes in and out.
struct Slot {
    world: World,
    action: Action,
    outcome: StepOutcome,
    observation: Box<Observation>,
    error: Option<WorldError>,
}

/// Worlds that one thread runs.
struct Shard {
    slots: Vec<Slot>,
    after_end: AfterEnd,
}

/// A thread and the way to wake it; it answers when its shard has stepped.
struct Worker {
    go: Option<SyncSender<()>>,
    done: Receiver<()>,
    thread: Option<JoinHandle<()>>,
}

/// Many worlds. See the module's documentation.
pub struct Batch {
    shards: Vec<Arc<Mutex<Shard>>>,
    workers: Vec<Worker>,
    worlds: usize,
}

/// What one world reports after a tick.
#[derive(Debug)]
pub struct Report<'a> {
    /// What the tick brought.
    pub outcome: StepOutcome,
    /// What the ego perceives now.
    pub observation: &'a Observation,
    /// The world itself; with [`AfterEnd::Restart`] already in its next episode.
    pub world: &'a World,
}

impl Batch {
    /// Worlds of this configuration, world k at the episode of `first_seed + k`.
    ///
    /// # Errors
    /// [`WorldError`] if the configuration is out of range or a seed has no map.
    pub fn new(
        world: &WorldConfig,
        batch: BatchConfig,
        first_seed: u64,
    ) -> Result<Batch, WorldError> {
        let worlds = batch.worlds.get();
        let first = World::new(world.clone())?;
        let mut slots = Vec::with_capacity(worlds);
        for k in 0..worlds {
            slots.push(Slot::new(first.clone(), first_seed + k as u64)?);
        }
        let threads = batch.threads.get().min(worlds);
        let mut shards = Vec::with_capacity(threads);
        for k in 0..threads {
            let rest = slots.split_off(slots.len().min(share(worlds, threads, k)));
            let slots = std::mem::replace(&mut slots, rest);
            let after_end = batch.after_end;
            shards.push(Arc::new(Mutex::new(Shard { slots, after_end })));
        }
        // A single shard is stepped by the caller.
        let workers = match shards.len() {
            1 => Vec::new(),
            _ => shards.iter().map(Worker::start).collect(),
        };
        Ok(Batch {
            shards,
            workers,
            worlds,
        })
    }

    /// Number of worlds.
    pub fn len(&self) -> usize {
        self.worlds
    }

    /// Never: a batch has at least one world.
    pub fn is_empty(&self) -> bool {
        self.worlds == 0
    }

    /// Begins the episode of `first_seed + k` in world k.
    ///
    /// # Errors
    /// [`WorldError`] of the first seed without a map; the worlds before it
    /// have begun theirs.
    pub fn reset(&mut self, first_seed: u64) -> Result<(), WorldError> {
        let mut seed = first_seed;
        for shard in &self.shards {
            for slot in &mut lock(shard).slots {
                slot.begin(seed)?;
                seed += 1;
            }
        }
        Ok(())
    }

    /// Steps all worlds by one tick, action k in world k; a world without an
    /// action brakes. Allocates nothing, but for episodes that begin anew.
    ///
    /// # Errors
    /// [`WorldError`] if a next episode's seed has no map; that world stays at
    /// the end of its episode. [`WorldError::DeadThread`] if a thread panicked.
    pub fn step(&mut self, actions: &[Action]) -> Result<(), WorldError> {
        let mut actions = actions.iter();
        for shard in &self.shards {
            for slot in &mut lock(shard).slots {
                slot.action = actions.next().copied().unwrap_or(Action::BRAKE);
            }
        }
        if self.workers.is_empty() {
            for shard in &self.shards {
                lock(shard).step();
            }
        }
        for worker in &self.workers {
            worker.wake()?;
        }
        for worker in &self.workers {
            worker.wait()?;
        }
        for shard in &self.shards {
            for slot in &mut lock(shard).slots {
                if let Some(error) = slot.error.take() {
                    return Err(error);
                }
            }
        }
        Ok(())
    }

    /// Shows every world's report in order.
    pub fn visit(&self, mut look: impl FnMut(usize, Report)) {
        let mut index = 0;
        for shard in &self.shards {
            for slot in &lock(shard).slots {
                let report = Report {
                    outcome: slot.outcome,
                    observation: &slot.observation,
                    world: &slot.world,
                };
                look(index, report);
                index += 1;
            }
        }
    }
}

/// How many of the worlds the k-th of the threads gets.
fn share(worlds: usize, threads: usize, k: usize) -> usize {
    worlds / threads + usize::from(k < worlds % threads)
}

/// A shard whose thread panicked still holds whole worlds: each slot is
/// written by one step at a time.
fn lock(shard: &Mutex<Shard>) -> MutexGuard<'_, Shard> {
    shard.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Slot {
    fn new(world: World, seed: u64) -> Result<Slot, WorldError> {
        let mut slot = Slot {
            outcome: world.last_step(),
            world,
            action: Action::BRAKE,
            observation: Box::default(),
            error: None,
        };
        slot.begin(seed)?;
        Ok(slot)
    }

    fn begin(&mut self, seed: u64) -> Result<(), WorldError> {
        self.world.reset(seed)?;
        self.outcome = self.world.last_step();
        self.world.observe(&mut self.observation);
        Ok(())
    }

    fn step(&mut self, after_end: AfterEnd) {
        self.outcome = self.world.step(self.action);
        if let AfterEnd::Restart { stride } = after_end
            && self.outcome.outcome != Outcome::Driving
        {
            let next = self.world.seed().wrapping_add(stride);
            self.error = self.world.reset(next).err();
        }
        self.world.observe(&mut self.observation);
    }
}

impl Shard {
    fn step(&mut self) {
        for slot in &mut self.slots {
            slot.step(self.after_end);
        }
    }
}

impl Worker {
    fn start(shard: &Arc<Mutex<Shard>>) -> Worker {
        let (go, awaited) = sync_channel::<()>(1);
        let (answer, done) = sync_channel::<()>(1);
        let shard = Arc::clone(shard);
        let thread = std::thread::spawn(move || {
            while awaited.recv().is_ok() {
                lock(&shard).step();
                if answer.send(()).is_err() {
                    return;
                }
            }
        });
        Worker {
            go: Some(go),
            done,
            thread: Some(thread),
        }
    }

    fn wake(&self) -> Result<(), WorldError> {
        let sent = self.go.as_ref().and_then(|go| go.send(()).ok());
        sent.ok_or(WorldError::DeadThread)
    }

    fn wait(&self) -> Result<(), WorldError> {
        self.done.recv().map_err(|_| WorldError::DeadThread)
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.go = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
