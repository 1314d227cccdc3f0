//! One environment: a world, the counters of its episode, and the row that it writes.

use std::cell::RefCell;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;
use safety::{Scene, assess};
use shm_config::config::SafetyLimits;
use shm_config::message::{Assessment, FEATURES, Header, Observation, Outcome};
use sim::idm::Idm;
use sim::render::{Renderer, Shot};
use sim::{World, WorldError};
use vehicle::{Action, Vehicle};

use crate::options::{Autoreset, Options};

/// Figures of a step beside reward and flags. First, the real numbers.
pub const REALS: [&str; 5] = [
    "cost",
    "step_reward",
    "route_completion",
    "velocity",
    "driven_m",
];
/// Second, the counts; the seed is stored by its bits.
pub const COUNTS: [&str; 4] = [
    "episode_length",
    "vehicle_contacts",
    "object_contacts",
    "seed",
];
/// Third, the flags.
pub const FLAGS: [&str; 7] = [
    "arrive_dest",
    "out_of_road",
    "max_step",
    "crash_vehicle",
    "crash_object",
    "crash_sidewalk",
    "strict_success",
];
/// Number of figures.
pub const FIGURES: usize = REALS.len() + COUNTS.len() + FLAGS.len();

/// Numbers of an observation before the lidar beams: car, road and route.
pub const STATE_FEATURES: usize = FEATURES - 240;

/// Ticks between two lane changes of the IDM driver; the first one is random below this.
const LANE_CHANGE_STEPS: u64 = 50;

/// Steering and pedal, each in [-1, 1].
pub type Pair = [f32; 2];

thread_local! {
    /// The observation of the world that the thread is at. [`World::observe`] writes all that
    /// is read of it, so that one stays in the cache where one for each world would not.
    static SEEN: RefCell<Box<Observation>> = RefCell::default();
}

/// Converts a pair to an action.
pub fn action(pair: Pair) -> Action {
    Action {
        steer: f64::from(pair[0]),
        pedal: f64::from(pair[1]),
    }
}

/// The episode that a reset begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reset {
    /// None: the current one continues.
    Keep,
    /// The next in the order of seeds.
    Next,
    /// The episode of this seed; the order of seeds restarts.
    To(u64),
}

/// Everything that brings another environment of the same options to the same state.
pub struct History<'a> {
    /// Seed of the episode.
    pub seed: u64,
    /// Position in the order of seeds.
    pub place: u64,
    /// Whether no episode of the order of seeds has begun.
    pub is_fresh: bool,
    /// The actions since the episode began.
    pub actions: &'a [Pair],
    /// The ticks at which the IDM driver was asked; it has memory.
    pub advised: &'a [u64],
}

/// One environment.
#[derive(Clone)]
pub struct Env {
    world: World,
    actions: Vec<Pair>,
    advised: Vec<u64>,
    idm: Idm,
    place: u64,
    /// Position at which this environment begins the order of seeds.
    first_place: u64,
    vehicle_contacts: u64,
    object_contacts: u64,
    noise: Option<Xoshiro256PlusPlus>,
    ended: bool,
    /// Whether no episode of the order of seeds has begun.
    is_fresh: bool,
}

/// The row of the output arrays that one environment writes.
pub struct Row<'a> {
    /// Features of the present observation, [0, 1].
    pub observation: &'a mut [f32],
    /// Features at the end of the episode, if this call began another one.
    pub final_observation: &'a mut [f32],
    /// The reward.
    pub reward: &'a mut f64,
    /// Whether the car's driving ended the episode.
    pub terminated: &'a mut bool,
    /// Whether the horizon ended the episode.
    pub truncated: &'a mut bool,
    /// Whether this call began an episode.
    pub began: &'a mut bool,
    /// One number for each of [`FIGURES`].
    pub figures: &'a mut [f64],
}

impl Env {
    /// An environment before its first episode, at its position in the order of seeds.
    pub fn new(options: &Options, world: World, place: u64) -> Env {
        Env {
            world,
            actions: Vec::with_capacity(options.world.horizon_steps.min(1 << 14) as usize),
            advised: Vec::new(),
            idm: Idm::new(0, 0),
            place,
            first_place: place,
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
        self.advised.clear();
        self.idm = Idm::new((seed.wrapping_mul(31) % LANE_CHANGE_STEPS) as u32, seed);
        (self.vehicle_contacts, self.object_contacts) = (0, 0);
        self.ended = false;
        let is_noisy = options.beam_noise > 0.0 || options.beam_dropout > 0.0;
        self.noise = is_noisy.then(|| Xoshiro256PlusPlus::seed_from_u64(seed));
        Ok(())
    }

    /// Begins the next episode in the order of seeds, `stride` positions further; the first call
    /// begins the episode of the first position.
    fn begin_next(&mut self, options: &Options, stride: u64) -> Result<(), WorldError> {
        let place = match self.is_fresh {
            true => self.place,
            false => self.place.wrapping_add(stride),
        };
        self.begin(options, options.seeds.at(place))?;
        (self.place, self.is_fresh) = (place, false);
        Ok(())
    }

    /// Begins an episode, unless `Reset::Keep`.
    ///
    /// # Errors
    /// [`WorldError`] if the seed has no map.
    pub fn reset(
        &mut self,
        options: &Options,
        reset: Reset,
        stride: u64,
        mut row: Row,
    ) -> Result<(), WorldError> {
        match reset {
            Reset::Keep => return Ok(()),
            Reset::Next => self.begin_next(options, stride)?,
            Reset::To(seed) => {
                self.begin(options, seed)?;
                (self.place, self.is_fresh) = (self.first_place, true);
            }
        }
        *row.began = true;
        self.perceive(options, row.observation);
        self.report(options, &mut row);
        Ok(())
    }

    /// Asks for the memory that the environments after an index read in their next step. Each
    /// has begun an episode.
    pub fn prefetch_after(index: usize, envs: &[Env]) {
        World::prefetch_after(index, |index| envs.get(index).map(|env| &env.world));
    }

    /// Whether the episode has ended, so that the next step drives nowhere.
    pub fn has_ended(&self) -> bool {
        self.ended
    }

    /// One step: drives, and handles the end of an episode as the options say.
    ///
    /// # Errors
    /// [`WorldError`] if the next seed has no map.
    pub fn step(
        &mut self,
        options: &Options,
        pair: Pair,
        stride: u64,
        mut row: Row,
    ) -> Result<(), WorldError> {
        *row.began = false;
        match (self.ended, options.autoreset) {
            // The episode has ended; its last figures repeat without a reward.
            (true, Autoreset::Disabled) => {
                *row.reward = 0.0;
                return Ok(());
            }
            (true, Autoreset::NextStep) => return self.reset(options, Reset::Next, stride, row),
            (true, Autoreset::SameStep) | (false, _) => {}
        }
        self.drive(pair);
        let ends = self.ends(options);
        self.ended = ends.0 || ends.1;
        self.report(options, &mut row);
        if self.ended && options.autoreset == Autoreset::SameStep {
            self.perceive(options, row.final_observation);
            self.begin_next(options, stride)?;
            *row.began = true;
        }
        self.perceive(options, row.observation);
        Ok(())
    }

    /// Drives for one tick.
    fn drive(&mut self, pair: Pair) {
        self.actions.push(pair);
        let step = self.world.step(action(pair));
        self.vehicle_contacts += u64::from(step.touch.vehicle);
        self.object_contacts += u64::from(step.touch.object);
    }

    /// Whether the episode is terminated, and whether it is truncated.
    fn ends(&self, options: &Options) -> (bool, bool) {
        let step = self.world.last_step();
        let crashed = options.crash_vehicle_done && step.touch.vehicle
            || options.crash_object_done && step.touch.object;
        let terminated = crashed || matches!(step.outcome, Outcome::Arrived | Outcome::OutOfRoad);
        (terminated, !terminated && step.outcome == Outcome::MaxStep)
    }

    fn perceive(&mut self, options: &Options, out: &mut [f32]) {
        SEEN.with_borrow_mut(|seen| {
            self.world.observe(seen);
            // The row has the length of the features for the configured beams.
            let _ = seen.features(out);
        });
        let Some(noise) = &mut self.noise else {
            return;
        };
        for beam in &mut out[STATE_FEATURES..] {
            if options.beam_noise > 0.0 {
                let error = noise.sample::<f64, _>(StandardNormal) * options.beam_noise;
                *beam = (f64::from(*beam) + error).clamp(0.0, 1.0) as f32;
            }
            if options.beam_dropout > 0.0 && noise.random::<f64>() < options.beam_dropout {
                *beam = 0.0;
            }
        }
    }

    /// Writes reward, flags and figures of the last tick.
    fn report(&self, options: &Options, row: &mut Row) {
        let (world, step) = (&self.world, self.world.last_step());
        let reward = match world.ticks() {
            0 => sim::Reward::default(),
            _ => options.reward.of(world),
        };
        *row.reward = reward.reward;
        (*row.terminated, *row.truncated) = self.ends(options);
        let flag = |value: bool| f64::from(u8::from(value));
        let arrived = step.outcome == Outcome::Arrived;
        let untouched = self.vehicle_contacts + self.object_contacts == 0;
        row.figures.copy_from_slice(&[
            reward.cost,
            reward.step_reward,
            world.completion(),
            world.speed_mps(),
            world.driven_m(),
            world.ticks() as f64,
            self.vehicle_contacts as f64,
            self.object_contacts as f64,
            // By its bits: an f64 cannot represent every seed.
            f64::from_bits(world.seed()),
            flag(arrived),
            flag(step.outcome == Outcome::OutOfRoad),
            flag(step.outcome == Outcome::MaxStep),
            flag(step.touch.vehicle),
            flag(step.touch.object),
            flag(step.on_sidewalk),
            flag(arrived && untouched),
        ]);
    }
}

impl Env {
    /// The history that repeats the present state.
    pub fn history(&self) -> History<'_> {
        History {
            seed: self.world.seed(),
            place: self.place,
            is_fresh: self.is_fresh,
            actions: &self.actions,
            advised: &self.advised,
        }
    }

    /// Repeats a history and writes the row of its last step.
    ///
    /// # Errors
    /// One line, if the seed has no map or the history is longer than the episode.
    pub fn replay(
        &mut self,
        options: &Options,
        history: &History,
        mut row: Row,
    ) -> Result<(), String> {
        self.begin(options, history.seed)
            .map_err(|error| error.to_string())?;
        (self.place, self.is_fresh) = (history.place, history.is_fresh);
        let mut advised = history.advised.iter().copied().peekable();
        // Each observation draws its noise, so all of them are repeated.
        self.perceive(options, row.observation);
        for (index, &pair) in history.actions.iter().enumerate() {
            if self.ends(options) != (false, false) {
                let count = history.actions.len();
                return Err(format!(
                    "the state has {count} actions, but its episode ends after {index}"
                ));
            }
            while advised.next_if_eq(&self.world.ticks()).is_some() {
                self.advise();
            }
            self.drive(pair);
            if self.noise.is_some() {
                self.perceive(options, row.observation);
            }
        }
        for _ in advised {
            self.advise();
        }
        if self.noise.is_none() {
            self.perceive(options, row.observation);
        }
        self.rest(options, &mut row);
        Ok(())
    }

    /// Copies another environment, except for the begin of its order of seeds.
    pub fn copy_from(&mut self, other: &Env) {
        let first_place = self.first_place;
        *self = other.clone();
        self.first_place = first_place;
    }

    /// Writes reward, flags and figures of the present state.
    pub fn rest(&mut self, options: &Options, row: &mut Row) {
        let ends = self.ends(options);
        self.ended = ends.0 || ends.1;
        self.report(options, row);
    }

    /// The action of MetaDrive's IDM driver. It has memory, so call this once per step.
    pub fn advise(&mut self) -> Pair {
        self.advised.push(self.world.ticks());
        let advice = self.world.advise(&mut self.idm).clamped();
        [advice.steer as f32, advice.pedal as f32]
    }

    /// The present observation without noise, with the header that seeds an expert's random
    /// numbers.
    pub fn perceived(&self, out: &mut Observation) {
        SEEN.with_borrow_mut(|seen| {
            self.world.observe(seen);
            out.clone_from(seen);
        });
        out.header = Header {
            tick: self.world.ticks(),
            episode: self.world.seed() as u32,
            ..Header::default()
        };
    }

    /// The safety check's assessment of a proposal, from the beams without noise.
    pub fn judge(&self, proposal: Pair) -> Assessment {
        let (vehicle, limits) = (Vehicle::default(), SafetyLimits::default());
        let proposal = Some(action(proposal).clamped());
        SEEN.with_borrow_mut(|seen| {
            self.world.observe(seen);
            let reach_m = Scene::reach_m(&vehicle, &limits, seen.ego.speed_mps);
            assess(&vehicle, &limits, &Scene::new(seen, reach_m), proposal)
        })
    }

    /// A picture of the world: rows from the top, red, green and blue. `None` if the size is
    /// zero or memory is short.
    pub fn draw(&self, shot: &Shot) -> Option<Vec<u8>> {
        let mut renderer = Renderer::default();
        renderer.begin(&self.world);
        renderer
            .draw(&self.world, shot)
            .map(|picture| picture.rgb.to_vec())
    }
}
