//! Imagined states, and what the expert would do at each.
//!
//! The expert is a program: it can be asked at any observation, which costs a
//! millisecond of the learner and no step of the world. Two kinds of states are useful:
//! those to which a rejected action would have led, and those near an observation, with
//! a lateral offset or added bodies.

use std::f64::consts::FRAC_PI_2;

use rand::{Rng, RngExt};
use shm_config::config::{Config, OutOfRange};
use shm_config::message::{Bend, FEATURES, MOTION_AT_REST, Observation, Preference};
use stack::oracle::Oracle;
use vehicle::{Action, Point, Pose, State, Vehicle, wrap_rad};

use crate::elsewhere;
use crate::replay::{ACTIONS, INPUTS, Then, Transition};

/// Time between predicted states, s.
const STRIDE_S: f64 = 0.2;
/// Steps of the bicycle model between them.
const STRIDE_STEPS: usize = 2;
/// Lateral offset, standard deviation, m: a fifth of a lane.
const ASIDE_M: f64 = 0.7;
/// Change of heading, standard deviation, rad: 7 degrees.
const TURN_RAD: f64 = 0.12;
/// Share of the states that get a random speed.
const SPEED_SHARE: f64 = 0.3;
/// The highest random speed, m/s.
const SPEED_MAX_MPS: f64 = 8.0;
/// The car's centre stays this far from the edges, m.
const EDGE_M: f64 = 1.2;
/// Distance ahead of an added body, m.
const AHEAD_M: std::ops::Range<f64> = 4.0..30.0;
/// Half lengths and half widths of added bodies: a cone, a barrier, a car, m.
const BODIES_M: [(f64, f64); 3] = [(0.2, 0.2), (0.15, 0.8), (2.3, 1.0)];
/// Number of added bodies, drawn uniformly from this list.
const BODY_COUNTS: [usize; 4] = [0, 1, 1, 2];
/// No body is added nearer than this ahead of the car's centre or beside it, m: it
/// would already touch the car.
const CLEAR_M: [f64; 2] = [3.5, 1.5];

/// Asks the expert at imagined states.
pub struct Imagination {
    oracle: Oracle,
    vehicle: Vehicle,
    there: Box<Observation>,
    tells_motion: bool,
}

impl Imagination {
    /// With the expert of this configuration.
    ///
    /// # Errors
    /// When the planner's configuration is out of range.
    pub fn new(config: &Config) -> Result<Imagination, OutOfRange> {
        Ok(Imagination {
            oracle: Oracle::new(config)?,
            vehicle: config.vehicle,
            there: Box::default(),
            tells_motion: config.learner.motion,
        })
    }

    /// Follows what moves, if the policy is told: the expert knows it at the states imagined
    /// around this observation, and the states tell it.
    pub fn watch(&mut self, observation: &Observation) {
        if self.tells_motion {
            self.oracle.watch(observation);
        }
    }

    /// Predicts this many states while a rejected action is held; `out` receives each
    /// with the expert's answer.
    pub fn predict(
        &mut self,
        observation: &Observation,
        (rejected, states): (Action, usize),
        mut out: impl FnMut(Transition),
    ) {
        let mut state = State::at_origin(observation.ego.speed_mps);
        let control = rejected.control(&self.vehicle);
        let step_s = STRIDE_S / STRIDE_STEPS as f64;
        for _ in 0..states {
            let before_rad = state.heading_rad;
            for _ in 0..STRIDE_STEPS {
                state = vehicle::step(&self.vehicle, &state, control, step_s);
            }
            let obeyed = (rejected.steer, rejected.pedal);
            elsewhere::observe(observation, &state, obeyed, &mut self.there);
            let turned_rad = wrap_rad(state.heading_rad - before_rad);
            self.there.ego.yaw_rate_radps = turned_rad / STRIDE_S;
            out(self.ask(Some(rejected)));
        }
    }

    /// A state near the observation, with added bodies.
    pub fn disturb(&mut self, observation: &Observation, random: &mut impl Rng) -> Transition {
        let (ego, road) = (&observation.ego, &observation.road);
        let mut state = State::at_origin(ego.speed_mps);
        let [left_m, right_m] = [road.left_m, road.right_m].map(|m| (m - EDGE_M).max(0.0));
        state.position.y = (ASIDE_M * normal(random)).clamp(-right_m, left_m);
        state.heading_rad = (TURN_RAD * normal(random)).clamp(-FRAC_PI_2, FRAC_PI_2);
        if random.random_bool(SPEED_SHARE) {
            state.speed_mps = random.random_range(0.0..SPEED_MAX_MPS);
        }
        elsewhere::observe(observation, &state, (ego.steer, ego.pedal), &mut self.there);
        for _ in 0..BODY_COUNTS[random.random_range(0..BODY_COUNTS.len())] {
            place(&mut self.there, random);
        }
        self.ask(None)
    }

    /// The imagined state with the expert's answer. Without a rejected action the
    /// answer is a target, but no preference.
    fn ask(&mut self, rejected: Option<Action>) -> Transition {
        let mut state = [0.0; INPUTS];
        let (features, motion) = state.split_at_mut(FEATURES);
        // Steps with another number of beams were refused before.
        self.there.features(features);
        motion.fill(MOTION_AT_REST);
        if self.tells_motion {
            motion.copy_from_slice(&self.oracle.motion(&self.there));
        }
        let expert = self.oracle.ask(&mut self.there);
        let rejected = rejected.unwrap_or(expert);
        let pair =
            |action: Action| -> [f32; ACTIONS] { [action.steer as f32, action.pedal as f32] };
        Transition {
            state,
            next: state,
            applied: pair(rejected),
            policy: pair(rejected),
            expert: pair(expert),
            label: Preference::Expert,
            then: Then::Unknown,
        }
    }
}

/// Adds a body to the road ahead.
fn place(observation: &mut Observation, random: &mut impl Rng) {
    let road = &observation.road;
    let checkpoint = &observation.checkpoints[0];
    let curvature = match checkpoint.bend() {
        Bend::Left if checkpoint.bend_radius_m > 0.0 => 1.0 / checkpoint.bend_radius_m,
        Bend::Right if checkpoint.bend_radius_m > 0.0 => -1.0 / checkpoint.bend_radius_m,
        Bend::Left | Bend::Right | Bend::Straight => 0.0,
    };
    let ahead_m = random.random_range(AHEAD_M);
    let right_m = road.right_m.max(0.1);
    let aside_m = random.random_range(-right_m..road.left_m.max(0.1));
    let (half_length_m, half_width_m) = BODIES_M[random.random_range(0..BODIES_M.len())];
    let across_m = aside_m - ahead_m * road.heading_rad.sin() + 0.5 * curvature * ahead_m * ahead_m;
    let heading_rad = curvature * ahead_m - road.heading_rad + 0.2 * normal(random);
    let [ahead_clear_m, aside_clear_m] = CLEAR_M;
    let in_the_car =
        ahead_m - half_length_m < ahead_clear_m && across_m.abs() - half_width_m < aside_clear_m;
    if !in_the_car {
        let body_from_box = vehicle::pose(ahead_m, across_m, heading_rad);
        let outline = outline(&body_from_box, half_length_m, half_width_m);
        elsewhere::place(&outline, observation);
    }
}

fn outline(body_from_box: &Pose, half_length_m: f64, half_width_m: f64) -> [Point; 4] {
    [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
        .map(|(x, y)| body_from_box * Point::new(x * half_length_m, y * half_width_m))
}

/// A normally distributed number (Box and Muller).
fn normal(random: &mut impl Rng) -> f64 {
    let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.random::<f64>()).cos()
}
