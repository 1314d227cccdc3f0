//! Many worlds at once, on one thread or several, with the same bits.
//!
//! Each world belongs to a shard, one for each thread; the caller's own thread steps the
//! last. A shard is locked by its thread while it steps, and by the caller between steps.
//! Worlds share nothing, so the number of threads cannot change a result.
//!
//! Threads wait for each other with a lock, which they try for a while, and then a condition
//! variable: a channel allocates at the first wait, which may be at any step.

use std::hint::spin_loop;
use std::num::NonZeroUsize;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use shm_config::message::{Observation, Outcome};
use vehicle::Action;

use crate::config::{WorldConfig, WorldError};
use crate::world::{StepOutcome, World};

/// How often a thread looks for work before it sleeps, about 100 us: to wake a sleeping one
/// takes tens of microseconds, more than a caller needs between two steps.
const TRIES: u32 = 2_000;

/// What happens to a world whose episode has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AfterEnd {
    /// It stays as it is until it is reset.
    Stay,
    /// Right after the tick that ended it, it begins the episode of its seed plus this
    /// stride. The report holds the outcome of the tick and the first observation of
    /// the new episode.
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
    /// Number of threads, the caller's own among them.
    pub threads: NonZeroUsize,
    /// What follows the end of an episode.
    pub after_end: AfterEnd,
}

/// One world of a batch, with its input and output.
struct Slot {
    world: World,
    action: Action,
    outcome: StepOutcome,
    observation: Box<Observation>,
    error: Option<WorldError>,
}

/// The state of a shard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// It waits, and its worlds may be read.
    Rest,
    /// Its thread steps its worlds.
    Step,
    /// Its thread ends.
    End,
    /// Its thread has ended, perhaps by a panic.
    Dead,
}

/// The worlds of one thread.
struct Shard {
    slots: Vec<Slot>,
    after_end: AfterEnd,
    phase: Phase,
}

/// A shard, with the condition variable that signals a change of its phase.
struct Desk {
    shard: Mutex<Shard>,
    changed: Condvar,
}

/// Many worlds. See the module's documentation.
pub struct Batch {
    desks: Vec<Arc<Desk>>,
    /// The threads of all shards but the last, which the caller steps.
    threads: Vec<JoinHandle<()>>,
    worlds: usize,
}

/// What one world reports after a tick.
#[derive(Debug)]
pub struct Report<'a> {
    /// The result of the tick.
    pub outcome: StepOutcome,
    /// The ego's present observation.
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
        let mut desks = Vec::with_capacity(threads);
        for k in 0..threads {
            let rest = slots.split_off(slots.len().min(share(worlds, threads, k)));
            let slots = std::mem::replace(&mut slots, rest);
            desks.push(Arc::new(Desk::new(slots, batch.after_end)));
        }
        // The caller steps the last shard.
        let threads = desks[..desks.len() - 1].iter().map(work_at).collect();
        Ok(Batch {
            desks,
            threads,
            worlds,
        })
    }

    /// Number of worlds.
    pub fn len(&self) -> usize {
        self.worlds
    }

    /// Always false: a batch has at least one world.
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
        for desk in &self.desks {
            for slot in &mut desk.lock().slots {
                slot.begin(seed)?;
                seed += 1;
            }
        }
        Ok(())
    }

    /// Steps all worlds by one tick, with action k in world k; a world without an
    /// action brakes. It allocates only where an episode begins.
    ///
    /// # Errors
    /// [`WorldError`] if a next episode's seed has no map; that world stays at
    /// the end of its episode. [`WorldError::DeadThread`] if a thread panicked.
    pub fn step(&mut self, actions: &[Action]) -> Result<(), WorldError> {
        let mut actions = actions.iter();
        for (k, desk) in self.desks.iter().enumerate() {
            let mut shard = desk.lock();
            for slot in &mut shard.slots {
                slot.action = actions.next().copied().unwrap_or(Action::BRAKE);
            }
            match k == self.threads.len() {
                true => shard.step(),
                false => desk.ask(shard)?,
            }
        }
        // All worlds have stepped before the first error is returned.
        let mut result = Ok(());
        for desk in &self.desks {
            let told = desk.answer().and_then(|mut shard| shard.take_error());
            result = result.and(told);
        }
        result
    }

    /// Shows every world's report in order.
    pub fn visit(&self, mut look: impl FnMut(usize, Report)) {
        let mut index = 0;
        for desk in &self.desks {
            for slot in &desk.lock().slots {
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

/// The number of worlds of the k-th thread.
fn share(worlds: usize, threads: usize, k: usize) -> usize {
    worlds / threads + usize::from(k < worlds % threads)
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
        for k in 0..self.slots.len() {
            World::prefetch_after(k, |k| self.slots.get(k).map(|slot| &slot.world));
            if let Some(next) = self.slots.get(k + 1) {
                next.world.prefetch_observation(&next.observation);
            }
            self.slots[k].step(self.after_end);
        }
    }

    /// Takes the first world's error; the errors of later worlds are dropped.
    fn take_error(&mut self) -> Result<(), WorldError> {
        let mut errors = self.slots.iter_mut().filter_map(|slot| slot.error.take());
        let first = errors.next();
        errors.for_each(drop);
        first.map_or(Ok(()), Err)
    }
}

impl Desk {
    fn new(slots: Vec<Slot>, after_end: AfterEnd) -> Desk {
        Desk {
            shard: Mutex::new(Shard {
                slots,
                after_end,
                phase: Phase::Rest,
            }),
            changed: Condvar::new(),
        }
    }

    /// The worlds of a shard whose thread panicked can still be read: each step writes
    /// one slot at a time.
    fn lock(&self) -> MutexGuard<'_, Shard> {
        self.shard.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the phase, unless the thread is dead.
    fn enter(&self, mut shard: MutexGuard<'_, Shard>, phase: Phase) {
        if shard.phase != Phase::Dead {
            shard.phase = phase;
        }
        drop(shard);
        // The caller and one thread use it, so at most one of them waits.
        self.changed.notify_one();
    }

    /// Waits while the shard is in this phase.
    fn wait_out<'a>(&'a self, shard: MutexGuard<'a, Shard>, phase: Phase) -> MutexGuard<'a, Shard> {
        drop(shard);
        for _ in 0..TRIES {
            if let Ok(shard) = self.shard.try_lock()
                && shard.phase != phase
            {
                return shard;
            }
            spin_loop();
        }
        self.changed
            .wait_while(self.lock(), |shard| shard.phase == phase)
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Wakes the thread, which then steps the shard.
    fn ask(&self, shard: MutexGuard<'_, Shard>) -> Result<(), WorldError> {
        let dead = shard.phase == Phase::Dead;
        self.enter(shard, Phase::Step);
        if dead {
            Err(WorldError::DeadThread)
        } else {
            Ok(())
        }
    }

    /// Waits until the shard has stepped.
    fn answer(&self) -> Result<MutexGuard<'_, Shard>, WorldError> {
        let shard = self.wait_out(self.lock(), Phase::Step);
        match shard.phase {
            Phase::Dead => Err(WorldError::DeadThread),
            Phase::Rest | Phase::Step | Phase::End => Ok(shard),
        }
    }

    /// The thread's loop, until the batch ends it.
    fn work(&self) {
        let _last = Last(self);
        loop {
            let mut shard = self.wait_out(self.lock(), Phase::Rest);
            match shard.phase {
                Phase::Step => shard.step(),
                Phase::Rest | Phase::End | Phase::Dead => return,
            }
            self.enter(shard, Phase::Rest);
        }
    }
}

/// Marks the thread as ended when it is dropped, which a panic does too.
struct Last<'a>(&'a Desk);

impl Drop for Last<'_> {
    fn drop(&mut self) {
        self.0.enter(self.0.lock(), Phase::Dead);
    }
}

fn work_at(desk: &Arc<Desk>) -> JoinHandle<()> {
    let desk = Arc::clone(desk);
    std::thread::spawn(move || desk.work())
}

impl Drop for Batch {
    fn drop(&mut self) {
        for desk in &self.desks {
            desk.enter(desk.lock(), Phase::End);
        }
        for thread in self.threads.drain(..) {
            // Its steps have already reported a panic.
            let _ = thread.join();
        }
    }
}
