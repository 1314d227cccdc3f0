//! The learner without its ports: takes steps, gives policies.

use std::fs;
use std::io;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::thread::available_parallelism;

use policy::Provenance;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use shm_config::config::{Algorithm, Config};
use shm_config::file::{Durable, Entry, Folder, is_unfinished, make_folders, replace};
use shm_config::message::{Driver, FEATURES, Step};
use vehicle::Action;

use crate::Rate;
use crate::algorithm::{Losses, Ppl, Pvp, Regression, Size, Source, Student, pvp, regression};
use crate::assembler::{Assembler, Labelling};
use crate::checkpoint::Checkpoint;
use crate::export;
use crate::imagine::Imagination;
use crate::journal::{Journal, Mark, Recovered};
use crate::metrics::{Metrics, Row};
use crate::replay::{Buffer, INPUTS, Replay, Transition};
use crate::unchanged;

/// Learning rate of the imitating algorithms, unless configured.
const IMITATION_RATE: f32 = 1e-3;
/// Learning rate of `pvp`, unless configured; PVP4Real.
const VALUE_RATE: f32 = 1e-4;

/// A learning session: the algorithm, its data and its files.
pub struct Session {
    config: Config,
    folder: PathBuf,
    assembler: Assembler,
    imagination: Option<Imagination>,
    replay: Replay,
    journal: Journal,
    metrics: Metrics,
    state: Checkpoint,
    /// Threads of an update. In lockstep the set waits, so all cores are free; in real
    /// time the other cores are busy.
    threads: usize,
    /// The build that learns, as its policy files name it.
    commit: String,
    /// The policy file that drives unchanged, if `learner.updates` is 0: the session records what
    /// `./vlaps relearn` learns from.
    unchanged: Option<Vec<u8>>,
    /// A write error is reported once; learning continues without saving.
    disk_failed: bool,
}

/// The result of a block.
pub struct Block {
    /// Steps driven at its end.
    pub steps: u64,
    /// The policy file.
    pub policy: Vec<u8>,
    /// Mean losses over the block.
    pub losses: Losses,
}

impl Session {
    /// Continues a session from this folder, or begins one.
    ///
    /// # Errors
    /// When the folder cannot be written, or holds a session of another algorithm, of
    /// other settings or of another version; when a policy file of the configured size is too
    /// large; when `learner.updates` is 0 and `policy.file` is no policy, or another one than before.
    pub fn open(config: &Config, folder: &Path) -> io::Result<Session> {
        make_folders(folder)?;
        Folder::open(folder, Entry::Readable)?.make_inside("policies", Entry::Readable)?;
        sweep(folder)?;
        sweep(&folder.join("policies"))?;
        let settings = &config.learner;
        let state = begun(config, folder)?;
        let metrics = Metrics::open(&folder.join("blocks.csv"), state.blocks)?;
        let path = folder.join("replay.bin");
        let capacity = settings.capacity as usize;
        let Recovered {
            journal,
            mut replay,
            mark,
            torn_bytes,
        } = Journal::open(&path, capacity, metrics.counts().transitions())
            .map_err(|error| named(error, &path))?;
        if torn_bytes > 0 {
            tracing::warn!(
                torn_bytes,
                "the end of the replay was incomplete and is cut off"
            );
        }
        replay.set_inputs(inputs(config));
        let labelling = Labelling {
            mode: config.gate.mode,
            wait_ns: (settings.label_wait_s * 1e9) as u64,
            truncated_at: (!settings.truncate_as_terminate).then(|| config.horizon_ticks()),
        };
        let mark = mark.unwrap_or_default().reached(&metrics.counts());
        let mut assembler = Assembler::new(labelling, mark.counts);
        if mark.sequence > 0 {
            assembler.follows((mark.producer, mark.sequence));
        }
        let asks = match settings.algorithm {
            Algorithm::Ppl => settings.predicted_states + settings.imagined_scenes > 0,
            Algorithm::Dagger => settings.imagined_scenes > 0,
            Algorithm::Pvp | Algorithm::Bc | Algorithm::HgDagger => false,
        };
        let imagination = match asks {
            true => Some(Imagination::new(config).map_err(io::Error::other)?),
            false => None,
        };
        let threads = match config.run.is_lockstep() {
            true => all_threads(),
            false => 1,
        };
        Ok(Session {
            threads,
            metrics,
            config: config.clone(),
            folder: folder.into(),
            assembler,
            imagination,
            replay,
            journal,
            unchanged: unchanged::same_policy(config, folder, &state)?,
            state,
            commit: std::env::var("VLAPS_COMMIT").unwrap_or_default(),
            disk_failed: false,
        })
    }

    /// Takes one admitted step.
    pub fn push(&mut self, step: &Step) {
        let mut made = Vec::new();
        self.assembler
            .push(step, |transition| made.push(transition));
        for transition in made {
            self.keep(transition.buffer(), transition);
        }
        self.imagine(step);
    }

    /// Steps driven since the session first began, including steps that the learner
    /// missed: a block ends where the controller's count says so.
    pub fn driven(&self) -> u64 {
        self.assembler.counts().driven()
    }

    /// Steps driven at the end of the last block that was learnt.
    pub fn learnt(&self) -> u64 {
        self.state.steps
    }

    /// Names another build in the policy files that follow.
    pub fn set_commit(&mut self, commit: String) {
        self.commit = commit;
    }

    /// Counts of steps and transitions.
    pub fn counts(&self) -> crate::assembler::Counts {
        self.assembler.counts()
    }

    /// Whether a block is complete whose updates are not made yet.
    pub fn is_due(&self) -> bool {
        self.block_end() > self.state.steps
    }

    /// The step at which the last complete block ended.
    fn block_end(&self) -> u64 {
        let driven = self.driven();
        driven - driven % u64::from(self.config.learner.block_steps)
    }

    /// Makes the updates of a block and saves them before the policy is published.
    /// `heartbeat` is called between them, so that the process counts as alive.
    ///
    /// # Errors
    /// When the policy cannot be exported, because its numbers are not finite. The
    /// state before the block then stays on disk.
    pub fn learn(&mut self, mut heartbeat: impl FnMut()) -> Result<Block, policy::Refusal> {
        let updates = self.config.learner.updates;
        let mut sum = Losses::default();
        for _ in 0..updates {
            heartbeat();
            let state = &mut self.state;
            let losses = state
                .student
                .update(&self.replay, &mut state.random, self.threads);
            sum.actor += losses.actor;
            sum.imitation += losses.imitation;
            sum.critic += losses.critic;
        }
        let count = updates.max(1) as f32;
        let losses = Losses {
            actor: sum.actor / count,
            imitation: sum.imitation / count,
            critic: sum.critic / count,
        };
        // The end counts even if the last steps of the block were missed: all runs
        // share one grid of blocks.
        self.state.steps = self.block_end();
        self.state.updates += u64::from(updates);
        self.state.blocks += 1;
        let policy = self.policy_file()?;
        heartbeat();
        let done = self.write_down(&policy, &losses, &mut heartbeat);
        self.tell(done);
        heartbeat();
        Ok(Block {
            steps: self.state.steps,
            policy,
            losses,
        })
    }

    /// The policy that drives until the end of the next block, as a file; `None` at the beginning,
    /// unless the policy never changes.
    ///
    /// # Errors
    /// When its numbers are not finite.
    pub fn driving_policy(&self) -> Result<Option<Vec<u8>>, policy::Refusal> {
        match self.learnt() == 0 && self.unchanged.is_none() {
            true => Ok(None),
            false => self.policy_file().map(Some),
        }
    }

    /// The present policy as a file.
    ///
    /// # Errors
    /// When its numbers are not finite.
    pub fn policy_file(&self) -> Result<Vec<u8>, policy::Refusal> {
        if let Some(file) = &self.unchanged {
            return Ok(file.clone());
        }
        let provenance = Provenance {
            algorithm: self.state.algorithm.clone(),
            seed: self.config.learner.seed,
            steps: self.state.steps,
            commit: self.commit.clone(),
        };
        export::with_probes(self.state.student.policy(), &provenance, &self.replay)
    }

    /// Ends the run: transitions that wait for a label are stored without one, and
    /// saved.
    pub fn finish(&mut self) {
        let mut made = Vec::new();
        self.assembler.finish(|transition| made.push(transition));
        for transition in made {
            self.keep(transition.buffer(), transition);
        }
        let done = self.journal.flush();
        self.tell(done);
    }

    /// Adds imagined states, for the algorithms that use them.
    fn imagine(&mut self, step: &Step) {
        let Some(mut imagination) = self.imagination.take() else {
            return;
        };
        let settings = self.config.learner;
        let observation = &step.observation;
        let mut made = Vec::new();
        let sees = step.observation_age_ns != u64::MAX && observation.fits_policy();
        if sees {
            imagination.watch(observation);
            for _ in 0..settings.imagined_scenes {
                made.push(imagination.disturb(observation, &mut self.state.random));
            }
            if let Some(rejected) = self.rejected(step) {
                let states = settings.predicted_states as usize;
                imagination.predict(observation, (rejected, states), |made_up| {
                    made.push(made_up);
                });
            }
        }
        self.imagination = Some(imagination);
        for transition in made {
            self.assembler.count_imagined();
            self.keep(Buffer::Predicted, transition);
        }
    }

    /// The policy's proposal, if another driver drove.
    fn rejected(&self, step: &Step) -> Option<Action> {
        let is_ppl = self.config.learner.algorithm == Algorithm::Ppl;
        let rejected = is_ppl && step.driver() != Driver::Policy;
        rejected.then(|| step.policy.action()).flatten()
    }

    fn keep(&mut self, buffer: Buffer, transition: Transition) {
        let mark = self.mark();
        let done = self.journal.append(buffer, &transition, &mark);
        let done = done.and_then(|()| self.journal.flush());
        self.tell(done);
        self.replay.push(buffer, transition);
    }

    fn mark(&self) -> Mark {
        let (producer, sequence) = self.assembler.heard().unwrap_or_default();
        Mark {
            counts: self.assembler.counts(),
            producer,
            sequence,
            updates: self.state.updates,
        }
    }

    fn write_down(
        &mut self,
        policy: &[u8],
        losses: &Losses,
        heartbeat: &mut dyn FnMut(),
    ) -> io::Result<()> {
        let mark = self.mark();
        self.journal.compact(&self.replay, &mark, heartbeat)?;
        // The journal is saved before the block that was learnt from it.
        self.journal.sync()?;
        let file = policy_path(&self.folder, self.state.steps);
        replace(&file, policy, Durable::Yes)?;
        self.metrics.write(&Row {
            steps: self.state.steps,
            updates: self.state.updates,
            counts: mark.counts,
            expert_queries: mark.counts.expert_queries(self.config.learner.algorithm),
            expert_ring: self.replay.len(Buffer::Expert) as u64,
            learner_ring: self.replay.len(Buffer::Learner) as u64,
            predicted_ring: self.replay.len(Buffer::Predicted) as u64,
            actor_loss: losses.actor,
            imitation_loss: losses.imitation,
            critic_loss: losses.critic,
        })?;
        self.state.write(&checkpoint_path(&self.folder))
    }

    fn tell(&mut self, done: io::Result<()>) {
        if let Err(error) = done
            && !self.disk_failed
        {
            self.disk_failed = true;
            let folder = self.folder.display();
            tracing::error!(%folder, %error, "cannot write; learning continues, but is not saved");
        }
    }
}

/// The state of the session in a folder, or of a new one.
fn begun(config: &Config, folder: &Path) -> io::Result<Checkpoint> {
    let path = checkpoint_path(folder);
    match Checkpoint::read(&path).map_err(|error| named(error, &path))? {
        Some(state) => {
            check_same(&state, config).map_err(|error| named(error, &path))?;
            Ok(state)
        }
        None => {
            let state = begin(config);
            export::check_size(state.student.policy())?;
            Ok(state)
        }
    }
}

/// An error with the name of its file.
pub(crate) fn named(error: io::Error, file: &Path) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", file.display()))
}

/// A session keeps the network sizes and learning rates with which it began.
fn check_same(state: &Checkpoint, config: &Config) -> io::Result<()> {
    let word = config.learner.algorithm.word();
    let refuse = |what: String| {
        let what = format!("{what}; move the folder away to start anew");
        Err(io::Error::new(io::ErrorKind::InvalidData, what))
    };
    if state.algorithm != word {
        let left = &state.algorithm;
        return refuse(format!("is a session of {left}, and {word} is configured"));
    }
    let now = begin(config).student.begun_with();
    for ((key, begun), (_, now)) in state.student.begun_with().into_iter().zip(now) {
        if begun != now {
            return refuse(format!(
                "was begun with {key} = {begun}, and {now} is configured"
            ));
        }
    }
    Ok(())
}

/// Removes the temporary file of a learner that was killed.
fn sweep(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default();
        if is_unfinished(&name.to_string_lossy()) && path.is_file() {
            fs::remove_file(path)?;
        }
    }
    Ok(())
}

/// The policy after so many steps.
pub(crate) fn policy_path(folder: &Path, steps: u64) -> PathBuf {
    folder.join(format!("policies/{steps:08}.onnx"))
}

fn checkpoint_path(folder: &Path) -> PathBuf {
    folder.join("learner.bin")
}

/// Threads that this machine has.
pub(crate) fn all_threads() -> usize {
    available_parallelism().map_or(1, NonZeroUsize::get)
}

/// How many numbers the policy takes.
pub(crate) fn inputs(config: &Config) -> usize {
    match config.learner.motion {
        true => INPUTS,
        false => FEATURES,
    }
}

/// The state of a new session.
pub(crate) fn begin(config: &Config) -> Checkpoint {
    let settings = &config.learner;
    let mut random = Xoshiro256PlusPlus::seed_from_u64(settings.seed);
    let size = Size {
        inputs: inputs(config),
        hidden: settings.hidden as usize,
        filters: settings.filters as usize,
        batch: settings.batch as usize,
    };
    let rate = |own: f32| Rate {
        start: match settings.rate > 0.0 {
            true => settings.rate as f32,
            false => own,
        },
        decay_steps: settings.decay_updates,
    };
    let imitation = regression::Settings {
        rate: rate(IMITATION_RATE),
        excess_pedal: settings.excess_pedal as f32,
    };
    let student = match settings.algorithm {
        Algorithm::Pvp => {
            let settings = pvp::Settings {
                rate: rate(VALUE_RATE),
                imitation_weight: settings.imitation_weight as f32,
                target_noise: settings.target_noise as f32,
                imitation_steer: settings.imitation_steer as f32,
                critic_scale: [settings.critic_steer as f32, settings.critic_pedal as f32],
                is_averaged: settings.averaged,
            };
            Student::Pvp(Box::new(Pvp::new(settings, size, &mut random)))
        }
        Algorithm::Ppl => Student::Ppl(Ppl::new(size, imitation, &mut random)),
        Algorithm::Bc | Algorithm::HgDagger => {
            let source = Source::Preferred;
            Student::Regression(Regression::new(source, size, imitation, &mut random))
        }
        Algorithm::Dagger => {
            let source = Source::All;
            Student::Regression(Regression::new(source, size, imitation, &mut random))
        }
    };
    Checkpoint {
        algorithm: settings.algorithm.word().into(),
        student,
        random,
        steps: 0,
        updates: 0,
        blocks: 0,
    }
}
