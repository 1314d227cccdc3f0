//! Many environments. Each writes its own row of the output arrays, so that the results do
//! not depend on the number of threads.

use std::num::NonZeroUsize;

use rayon::{ThreadPool, ThreadPoolBuilder};
use shm_config::config::Config;
use sim::{World, WorldError};

use crate::env::{Env, FIGURES, Pair, Reset, Row, STATE_FEATURES};
use crate::expert::{Expert, Experts};
use crate::options::Options;

/// Output arrays of a batch or of a part of it: one row per environment.
pub struct Arrays<'a> {
    /// `[worlds, features]`.
    pub observation: &'a mut [f32],
    /// `[worlds, features]`.
    pub final_observation: &'a mut [f32],
    /// `[worlds]`.
    pub reward: &'a mut [f64],
    /// `[worlds]`.
    pub terminated: &'a mut [bool],
    /// `[worlds]`.
    pub truncated: &'a mut [bool],
    /// `[worlds]`.
    pub began: &'a mut [bool],
    /// `[worlds, FIGURES]`.
    pub figures: &'a mut [f64],
}

impl<'a> Arrays<'a> {
    /// Splits the rows after the first `worlds` environments.
    fn split_at(self, worlds: usize, features: usize) -> (Arrays<'a>, Arrays<'a>) {
        let observation = self.observation.split_at_mut(worlds * features);
        let final_observation = self.final_observation.split_at_mut(worlds * features);
        let reward = self.reward.split_at_mut(worlds);
        let terminated = self.terminated.split_at_mut(worlds);
        let truncated = self.truncated.split_at_mut(worlds);
        let began = self.began.split_at_mut(worlds);
        let figures = self.figures.split_at_mut(worlds * FIGURES);
        let left = Arrays {
            observation: observation.0,
            final_observation: final_observation.0,
            reward: reward.0,
            terminated: terminated.0,
            truncated: truncated.0,
            began: began.0,
            figures: figures.0,
        };
        let right = Arrays {
            observation: observation.1,
            final_observation: final_observation.1,
            reward: reward.1,
            terminated: terminated.1,
            truncated: truncated.1,
            began: began.1,
            figures: figures.1,
        };
        (left, right)
    }

    /// The row of one environment.
    pub fn row(&mut self, index: usize, features: usize) -> Row<'_> {
        let place = index * features..(index + 1) * features;
        let figures = index * FIGURES..(index + 1) * FIGURES;
        Row {
            observation: &mut self.observation[place.clone()],
            final_observation: &mut self.final_observation[place],
            reward: &mut self.reward[index],
            terminated: &mut self.terminated[index],
            truncated: &mut self.truncated[index],
            began: &mut self.began[index],
            figures: &mut self.figures[figures],
        }
    }
}

/// Calls `each` for every index of the environments, with its input and its row. The pool's
/// threads may take halves of the batch, down to `grain` environments.
fn for_each<I: Sync>(
    grain: usize,
    (envs, inputs, mut arrays): (&mut [Env], &[I], Arrays),
    each: &(impl Fn(&mut [Env], usize, &I, Row) -> Result<(), WorldError> + Sync),
) -> Result<(), WorldError> {
    let features = arrays.observation.len() / envs.len().max(1);
    if envs.len() <= grain {
        // Every environment takes its step before the first error is reported.
        let mut first = Ok(());
        for (index, input) in inputs.iter().enumerate() {
            let result = each(envs, index, input, arrays.row(index, features));
            first = first.and(result);
        }
        return first;
    }
    let middle = envs.len() / 2;
    let (left, right) = envs.split_at_mut(middle);
    let (left_inputs, right_inputs) = inputs.split_at(middle);
    let (left_arrays, right_arrays) = arrays.split_at(middle, features);
    let (left, right) = rayon::join(
        || for_each(grain, (left, left_inputs, left_arrays), each),
        || for_each(grain, (right, right_inputs, right_arrays), each),
    );
    left.and(right)
}

/// The same on the threads of the pool, or on the caller's without a pool.
fn for_all<I: Sync>(
    threads: Option<&ThreadPool>,
    grain: usize,
    work: (&mut [Env], &[I], Arrays),
    each: &(impl Fn(&mut [Env], usize, &I, Row) -> Result<(), WorldError> + Sync),
) -> Result<(), WorldError> {
    match threads {
        None => for_each(grain, work, each),
        Some(threads) => threads.install(|| for_each(grain, work, each)),
    }
}

/// Many environments, and the threads that step them.
pub struct Batch {
    /// Options of all environments.
    pub options: Options,
    envs: Vec<Env>,
    /// `None`: the caller's thread steps all environments.
    threads: Option<ThreadPool>,
    grain: usize,
    experts: Experts,
}

impl Batch {
    /// Creates environments before their first episode; the experts have their own
    /// configuration.
    ///
    /// # Errors
    /// One line: an option is out of range, or a thread cannot be started.
    pub fn new(
        options: Options,
        experts: Config,
        worlds: NonZeroUsize,
        threads: NonZeroUsize,
    ) -> Result<Batch, String> {
        let world = World::new(options.world.clone()).map_err(|error| error.to_string())?;
        let env = |place: usize| Env::new(&options, world.clone(), place as u64);
        let envs = (0..worlds.get()).map(env).collect();
        let count = threads.get().min(worlds.get());
        let pool = || {
            ThreadPoolBuilder::new()
                .num_threads(count)
                .thread_name(|index| format!("vlaps-world-{index}"))
                .build()
                .map_err(|error| format!("cannot start {count} threads: {error}"))
        };
        Ok(Batch {
            options,
            experts: Experts::new(experts),
            threads: (count > 1).then(pool).transpose()?,
            // Several parts per thread balance episodes of unequal cost.
            grain: match count {
                1 => worlds.get(),
                _ => worlds.get().div_ceil(count * 8),
            },
            envs,
        })
    }

    /// Number of environments.
    pub fn len(&self) -> usize {
        self.envs.len()
    }

    /// Number of threads of the pool; 0 if the caller's thread steps all environments.
    pub fn threads(&self) -> usize {
        self.threads
            .as_ref()
            .map_or(0, ThreadPool::current_num_threads)
    }

    /// Numbers in an observation.
    pub fn features(&self) -> usize {
        STATE_FEATURES + self.options.world.scanner.beams as usize
    }

    /// One environment with the options; `None` if the index is out of range.
    pub fn env(&mut self, index: usize) -> Option<(&Options, &mut Env)> {
        let options = &self.options;
        self.envs.get_mut(index).map(|env| (options, env))
    }

    /// Actions of an expert in the wanted environments; NaN in the others.
    ///
    /// # Errors
    /// One line, if the planner's configuration is out of range.
    pub fn advise(&mut self, expert: Expert, wanted: &[bool]) -> Result<Vec<Pair>, String> {
        let method = match expert {
            Expert::Planner(method) => method,
            Expert::Idm => {
                let asked = self.envs.iter_mut().zip(wanted);
                let advise = |(env, &wanted): (&mut Env, &bool)| match wanted {
                    true => env.advise(),
                    false => [f32::NAN; 2],
                };
                return Ok(asked.map(advise).collect());
            }
        };
        let (experts, work) = (&self.experts, (&self.envs[..], wanted));
        match &self.threads {
            None => experts.ask(method, work, 1),
            Some(threads) => {
                let workers = threads.current_num_threads();
                threads.install(|| experts.ask(method, work, workers))
            }
        }
    }

    /// Drives each environment for one tick with its action.
    ///
    /// # Errors
    /// [`WorldError`] of the first environment whose next seed has no map.
    pub fn step(&mut self, actions: &[Pair], arrays: Arrays) -> Result<(), WorldError> {
        let (options, stride) = (&self.options, self.envs.len() as u64);
        let each = |envs: &mut [Env], index: usize, pair: &Pair, row: Row| {
            Env::prefetch_after(index, envs);
            envs[index].step(options, *pair, stride, row)
        };
        let work = (&mut self.envs[..], actions, arrays);
        for_all(self.threads.as_ref(), self.grain, work, &each)
    }

    /// Begins episodes.
    ///
    /// # Errors
    /// [`WorldError`] of the first seed that has no map; the others have begun.
    pub fn reset(&mut self, resets: &[Reset], arrays: Arrays) -> Result<(), WorldError> {
        let (options, stride) = (&self.options, self.envs.len() as u64);
        let each = |envs: &mut [Env], index: usize, reset: &Reset, row: Row| {
            envs[index].reset(options, *reset, stride, row)
        };
        let work = (&mut self.envs[..], resets, arrays);
        for_all(self.threads.as_ref(), self.grain, work, &each)
    }
}
