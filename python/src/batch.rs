//! Many environments at once. Each writes its own row of the output arrays, so the
//! number of threads cannot change a result.

use std::num::NonZeroUsize;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::{ThreadPool, ThreadPoolBuilder};
use shm_config::message::{Observation, Outcome};
use sim::{World, WorldError};
use vehicle::Action;

use crate::options::{Autoreset, Options};

/// Figures of a tick that go out beside reward and flags, in this order.
pub const FIGURES: [&str; 15] = [
    "cost",
    "step_reward",
    "route_completion",
    "velocity",
    "episode_length",
    "arrive_dest",
    "out_of_road",
    "max_step",
    "crash_vehicle",
    "crash_object",
    "crash_sidewalk",
    "vehicle_contacts",
    "object_contacts",
    "strict_success",
    "seed",
];

/// One environment: a world, and the account of its episode.
#[derive(Clone)]
pub struct Env {
    world: World,
    observation: Box<Observation>,
    /// Actions of this episode, which with its seed make its state.
    actions: Vec<Action>,
    /// Its place in the order of seeds.
    place: u64,
    vehicle_contacts: u64,
    object_contacts: u64,
    noise: Option<Xoshiro256PlusPlus>,
    ended: bool,
    /// No episode of the order of seeds has begun.
    is_fresh: bool,
}

/// The row of the output arrays that one environment writes.
pub struct Row<'a> {
    /// The features of what is perceived now, [0, 1].
    pub observation: &'a mut [f32],
    /// Those of the end of the episode, when this call began another one.
    pub final_observation: &'a mut [f32],
    /// The reward.
    pub reward: &'a mut f64,
    /// The episode has ended by what the car did.
    pub terminated: &'a mut bool,
    /// The episode has ended by its length.
    pub truncated: &'a mut bool,
    /// This call began an episode.
    pub began: &'a mut bool,
    /// One number for each of [`FIGURES`].
    pub figures: &'a mut [f64],
}

impl Env {
    fn new(options: &Options, world: World) -> Env {
        Env {
            world,
            observation: Box::default(),
            actions: Vec::with_capacity(options.world.horizon_steps.min(1 << 14) as usize),
            place: 0,
            vehicle_contacts: 0,
            object_contacts: 0,
            noise: None,
            ended: false,
            is_fresh: true,
        }
    }

    /// Begins the episode of a seed.
    fn begin(&mut self, options: &Options, seed: u64) -> Result<(), WorldError> {
        self.world.reset(seed)?;
        self.actions.clear();
        (self.vehicle_contacts, self.object_contacts) = (0, 0);
        self.ended = false;
        let is_noisy = options.beam_noise > 0.0 || options.beam_dropout > 0.0;
        self.noise = is_noisy.then(|| Xoshiro256PlusPlus::seed_from_u64(seed));
        Ok(())
    }

    /// Begins the next episode in the order of seeds, `stride` places on; at first that
    /// of its own place.
    fn begin_next(&mut self, options: &Options, stride: u64) -> Result<(), WorldError> {
        let place = match self.is_fresh {
            true => self.place,
            false => self.place + stride,
        };
        self.begin(options, options.seeds.at(place))?;
        (self.place, self.is_fresh) = (place, false);
        Ok(())
    }

    fn reset(
        &mut self,
        options: &Options,
        reset: Reset,
        stride: u64,
        row: Row,
    ) -> Result<(), WorldError> {
        match reset {
            Reset::Keep => return Ok(()),
            Reset::Next => self.begin_next(options, stride)?,
            Reset::To(seed) => self.begin(options, seed)?,
        }
        (*row.reward, *row.terminated, *row.truncated) = (0.0, false, false);
        *row.began = true;
        self.perceive(options, row.observation);
        self.figures(options, row.figures);
        Ok(())
    }

    /// Drives for one tick.
    fn drive(&mut self, action: Action) {
        self.actions.push(action);
        let step = self.world.step(action);
        self.vehicle_contacts += u64::from(step.touch.vehicle);
        self.object_contacts += u64::from(step.touch.object);
    }

    fn ends(&self, options: &Options) -> (bool, bool) {
        let step = self.world.last_step();
        let crashed = options.crash_vehicle_done && step.touch.vehicle
            || options.crash_object_done && step.touch.object;
        let terminated = crashed || matches!(step.outcome, Outcome::Arrived | Outcome::OutOfRoad);
        (terminated, !terminated && step.outcome == Outcome::MaxStep)
    }

    fn perceive(&mut self, options: &Options, out: &mut [f32]) {
        self.world.observe(&mut self.observation);
        // The row is as long as the features of the configured beams.
        let _ = self.observation.features(out);
        if let Some(noise) = &mut self.noise {
            for beam in &mut out[shm_config::message::FEATURES - 240..] {
                if options.beam_noise > 0.0 {
                    let noisy = f64::from(*beam)
                        + noise.sample::<f64, _>(StandardNormal) * options.beam_noise;
                    *beam = noisy.clamp(0.0, 1.0) as f32;
                }
                if options.beam_dropout > 0.0 && noise.random::<f64>() < options.beam_dropout {
                    *beam = 0.0;
                }
            }
        }
    }
}

impl Env {
    /// One call: drives, and does with an ended episode what the options say.
    fn step(
        &mut self,
        options: &Options,
        action: Action,
        stride: u64,
        row: Row,
    ) -> Result<(), WorldError> {
        *row.began = false;
        if self.ended && options.autoreset != Autoreset::SameStep {
            if options.autoreset == Autoreset::Disabled {
                // The world stands still; its last figures repeat without a reward.
                *row.reward = 0.0;
                return Ok(());
            }
            self.begin_next(options, stride)?;
            *row.began = true;
            (*row.reward, *row.terminated, *row.truncated) = (0.0, false, false);
            self.perceive(options, row.observation);
            self.figures(options, row.figures);
            return Ok(());
        }
        self.drive(action);
        let (terminated, truncated) = self.ends(options);
        let reward = options.reward.of(&self.world);
        *row.reward = reward.reward;
        (*row.terminated, *row.truncated) = (terminated, truncated);
        self.figures(options, row.figures);
        self.ended = terminated || truncated;
        if self.ended && options.autoreset == Autoreset::SameStep {
            self.perceive(options, row.final_observation);
            self.begin_next(options, stride)?;
            *row.began = true;
        }
        self.perceive(options, row.observation);
        Ok(())
    }

    fn figures(&self, options: &Options, out: &mut [f64]) {
        let (world, step) = (&self.world, self.world.last_step());
        let reward = match world.ticks() {
            0 => sim::Reward::default(),
            _ => options.reward.of(world),
        };
        let flag = |value: bool| f64::from(u8::from(value));
        let arrived = step.outcome == Outcome::Arrived;
        let untouched = self.vehicle_contacts + self.object_contacts == 0;
        out.copy_from_slice(&[
            reward.cost,
            reward.step_reward,
            world.completion(),
            world.speed_mps(),
            world.ticks() as f64,
            flag(arrived),
            flag(step.outcome == Outcome::OutOfRoad),
            flag(step.outcome == Outcome::MaxStep),
            flag(step.touch.vehicle),
            flag(step.touch.object),
            flag(step.on_sidewalk),
            self.vehicle_contacts as f64,
            self.object_contacts as f64,
            flag(arrived && untouched),
            world.seed() as f64,
        ]);
    }

    /// What would bring another environment of these options here: seed, place in the
    /// order of seeds, and the actions since the episode began.
    pub fn history(&self) -> (u64, u64, &[Action]) {
        (self.world.seed(), self.place, &self.actions)
    }

    /// Drives a seed's episode with these actions.
    ///
    /// # Errors
    /// [`WorldError`] when the seed has no map.
    pub fn replay(
        &mut self,
        options: &Options,
        (seed, place): (u64, u64),
        actions: &[Action],
    ) -> Result<(), WorldError> {
        self.begin(options, seed)?;
        (self.place, self.is_fresh) = (place, false);
        // Each observation draws its noise, so each is made again.
        let mut features = vec![0.0; 19 + options.world.beam_count];
        self.perceive(options, &mut features);
        for &action in actions {
            self.drive(action);
            if self.noise.is_some() {
                self.perceive(options, &mut features);
            }
        }
        let (terminated, truncated) = self.ends(options);
        self.ended = terminated || truncated;
        Ok(())
    }
}

/// Arrays of a batch, or of a part of it: one row for each environment.
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
    fn split_at(self, worlds: usize, features: usize) -> (Arrays<'a>, Arrays<'a>) {
        let observation = self.observation.split_at_mut(worlds * features);
        let final_observation = self.final_observation.split_at_mut(worlds * features);
        let reward = self.reward.split_at_mut(worlds);
        let terminated = self.terminated.split_at_mut(worlds);
        let truncated = self.truncated.split_at_mut(worlds);
        let began = self.began.split_at_mut(worlds);
        let figures = self.figures.split_at_mut(worlds * FIGURES.len());
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

    fn row(&mut self, index: usize, features: usize) -> Row<'_> {
        let place = index * features..(index + 1) * features;
        let figures = index * FIGURES.len()..(index + 1) * FIGURES.len();
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

/// Calls `each` for every environment with its input and its row, in halves that threads
/// of the pool may take, down to `grain` environments.
fn for_each<I: Sync>(
    grain: usize,
    (envs, inputs, mut arrays): (&mut [Env], &[I], Arrays),
    each: &(impl Fn(&mut Env, &I, Row) -> Result<(), WorldError> + Sync),
) -> Result<(), WorldError> {
    let features = arrays.observation.len() / envs.len().max(1);
    if envs.len() <= grain {
        let pairs = envs.iter_mut().zip(inputs).enumerate();
        // Every environment takes its step before the first error is reported.
        let results =
            pairs.map(|(index, (env, input))| each(env, input, arrays.row(index, features)));
        return results.fold(Ok(()), |first, result| first.and(result));
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

/// Which episode a reset begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reset {
    /// None: the running one goes on.
    Keep,
    /// The next in the order of seeds.
    Next,
    /// That of this seed.
    To(u64),
}

/// Many environments, and the threads that step them.
pub struct Batch {
    /// What they are like.
    pub options: Options,
    envs: Vec<Env>,
    /// None: the caller's own thread steps them all.
    threads: Option<ThreadPool>,
    grain: usize,
}

impl Batch {
    /// Environments of these options, each before its first episode.
    ///
    /// # Errors
    /// One line: an option out of range, or no thread to be had.
    pub fn new(
        options: Options,
        worlds: NonZeroUsize,
        threads: NonZeroUsize,
    ) -> Result<Batch, String> {
        let world = World::new(options.world.clone()).map_err(|error| error.to_string())?;
        let mut envs = vec![Env::new(&options, world); worlds.get()];
        for (place, env) in envs.iter_mut().enumerate() {
            env.place = place as u64;
        }
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
            threads: (count > 1).then(pool).transpose()?,
            // Several parts for each thread even out episodes of unequal cost.
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

    /// Threads beside the caller's; 0 when that steps all environments.
    pub fn threads(&self) -> usize {
        self.threads
            .as_ref()
            .map_or(0, ThreadPool::current_num_threads)
    }

    /// Numbers in an observation.
    pub fn features(&self) -> usize {
        19 + self.options.world.beam_count
    }

    /// One environment with the options; `None` beyond the last.
    pub fn env(&mut self, index: usize) -> Option<(&Options, &mut Env)> {
        let options = &self.options;
        self.envs.get_mut(index).map(|env| (options, env))
    }

    /// Drives each environment for one tick with its action.
    ///
    /// # Errors
    /// [`WorldError`] of the first environment whose next seed has no map.
    pub fn step(&mut self, actions: &[Action], arrays: Arrays) -> Result<(), WorldError> {
        let (options, stride) = (&self.options, self.envs.len() as u64);
        let each =
            |env: &mut Env, action: &Action, row: Row| env.step(options, *action, stride, row);
        let work = (&mut self.envs[..], actions, arrays);
        match &self.threads {
            None => for_each(self.grain, work, &each),
            Some(threads) => threads.install(|| for_each(self.grain, work, &each)),
        }
    }

    /// Begins episodes.
    ///
    /// # Errors
    /// [`WorldError`] of the first seed that has no map; the others have begun.
    pub fn reset(&mut self, resets: &[Reset], arrays: Arrays) -> Result<(), WorldError> {
        let (options, stride) = (&self.options, self.envs.len() as u64);
        let each = |env: &mut Env, reset: &Reset, row: Row| env.reset(options, *reset, stride, row);
        let work = (&mut self.envs[..], resets, arrays);
        match &self.threads {
            None => for_each(self.grain, work, &each),
            Some(threads) => threads.install(|| for_each(self.grain, work, &each)),
        }
    }

    /// Puts the order of seeds back to its beginning.
    pub fn rewind(&mut self) {
        for (place, env) in self.envs.iter_mut().enumerate() {
            (env.place, env.is_fresh) = (place as u64, true);
        }
    }
}
