//! Many environments. Each writes its own row of the output arrays, so that the results do
//! not depend on the number of threads.

use std::num::NonZeroUsize;
use std::sync::{Mutex, PoisonError};

use shm_config::config::Config;
use sim::{World, WorldError};

use crate::crew::Crew;
use crate::env::{Env, FIGURES, Pair, Reset, Row, STATE_FEATURES};
use crate::expert::{Expert, Experts};
use crate::options::Options;

/// Parts of each thread's environments, if there are several threads. The last is 1/16 of them.
const PARTS: usize = 5;

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

/// A part of the environments, with its inputs and rows.
type Part<'a, I> = (&'a mut [Env], &'a [I], Arrays<'a>);

/// The environments in parts that one thread takes whole.
struct Parts<'a, I> {
    /// The parts of the first thread, then those of the second, and so on; `None` once taken.
    parts: Vec<Mutex<Option<Part<'a, I>>>>,
    /// Number of parts of each thread.
    each: usize,
}

impl<'a, I> Parts<'a, I> {
    /// Gives each thread parts of decreasing size: the others take its last ones, if one of
    /// its episodes begins, which takes as long as dozens of steps.
    fn new(threads: usize, work: Part<'a, I>) -> Parts<'a, I> {
        let each = match threads {
            1 => 1,
            _ => PARTS,
        };
        let (mut envs, mut inputs, mut arrays) = work;
        let features = arrays.observation.len() / envs.len().max(1);
        let mut parts = Vec::with_capacity(threads * each);
        for thread in 0..threads {
            let mut share = envs.len().div_ceil(threads - thread);
            for left in (0..each).rev() {
                // Half of what is left, and all of it at last.
                let count = if left == 0 { share } else { share.div_ceil(2) };
                share -= count;
                let (first, rest) = envs.split_at_mut(count);
                let (asked, others) = inputs.split_at(count);
                let (rows, rest_rows) = arrays.split_at(count, features);
                parts.push(Mutex::new(Some((first, asked, rows))));
                (envs, inputs, arrays) = (rest, others, rest_rows);
            }
        }
        Parts { parts, each }
    }

    /// Takes the next part for a thread: its own in order, then the others' from the last on.
    fn take(&self, thread: usize) -> Option<(usize, Part<'a, I>)> {
        let own = thread * self.each..(thread + 1) * self.each;
        let before = (0..own.start).rev();
        let after = (own.end..self.parts.len()).rev();
        own.chain(after).chain(before).find_map(|place| {
            let part = &self.parts[place];
            let taken = part.lock().unwrap_or_else(PoisonError::into_inner).take();
            taken.map(|part| (place, part))
        })
    }
}

/// Calls `each` for every index of the environments, with its input and its row, on the crew's
/// threads. Every environment takes its step before the first error is returned.
fn for_all<I: Sync>(
    crew: &Crew,
    work: Part<I>,
    each: &(impl Fn(&mut [Env], usize, &I, Row) -> Result<(), WorldError> + Sync),
) -> Result<(), WorldError> {
    let features = work.2.observation.len() / work.0.len().max(1);
    let parts = Parts::new(crew.threads(), work);
    let errors = Mutex::new(Vec::new());
    crew.run(&|thread| {
        while let Some((place, (envs, inputs, mut arrays))) = parts.take(thread) {
            for (index, input) in inputs.iter().enumerate() {
                if let Err(error) = each(envs, index, input, arrays.row(index, features)) {
                    let mut errors = errors.lock().unwrap_or_else(PoisonError::into_inner);
                    errors.push((place, index, error));
                }
            }
        }
    });
    let errors = errors.into_inner().unwrap_or_else(PoisonError::into_inner);
    let first = errors
        .into_iter()
        .min_by_key(|&(place, index, _)| (place, index));
    first.map_or(Ok(()), |(_, _, error)| Err(error))
}

/// Many environments, and the threads that step them.
pub struct Batch {
    /// Options of all environments.
    pub options: Options,
    envs: Vec<Env>,
    crew: Crew,
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
        Ok(Batch {
            options,
            experts: Experts::new(experts),
            crew: Crew::new(threads.min(worlds))?,
            envs,
        })
    }

    /// Number of environments.
    pub fn len(&self) -> usize {
        self.envs.len()
    }

    /// Whether the episode of each environment has ended.
    pub fn ended(&self) -> Vec<bool> {
        self.envs.iter().map(Env::has_ended).collect()
    }

    /// Number of threads, the caller's among them.
    pub fn threads(&self) -> usize {
        self.crew.threads()
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
        self.experts.ask(method, (&self.envs, wanted), &self.crew)
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
        for_all(&self.crew, work, &each)
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
        for_all(&self.crew, work, &each)
    }
}
