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
use tracker::Moving;
use vehicle::{Action, Point, Pose, State, Vector, Vehicle, wrap_rad};

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
const BODIES_M: [(f64, f64); 3] = [(0.2, 0.2), (0.15, 0.8), CAR_M];
/// Half the length and half the width of a car, m.
const CAR_M: (f64, f64) = (2.3, 1.0);
/// Distance ahead of an added car that moves, m.
const TRAFFIC_AHEAD_M: std::ops::Range<f64> = -20.0..40.0;
/// Its speed, m/s: MetaDrive's traffic wants up to 11.
const TRAFFIC_SPEED_MPS: std::ops::Range<f64> = 0.0..12.0;
/// Distance between its imagined returns, m.
const TRAFFIC_RETURNS_M: f64 = 0.5;
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
    cars_max: u32,
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
            cars_max: config.learner.imagined_cars,
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
            if let Some(body) = Body::draw(&self.there, (AHEAD_M, &BODIES_M), random) {
                elsewhere::place(&body.outline(), &mut self.there);
            }
        }
        if self.tells_motion && self.cars_max > 0 {
            self.add_traffic(random);
        }
        let asked = self.ask(None);
        self.oracle.forget_imagined();
        asked
    }

    /// Adds cars that drive along the road.
    fn add_traffic(&mut self, random: &mut impl Rng) {
        let ego = &self.there.ego;
        let world_from_body = vehicle::pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad);
        for _ in 0..random.random_range(0..=self.cars_max) {
            let Some(car) = Body::draw(&self.there, (TRAFFIC_AHEAD_M, &[CAR_M]), random) else {
                continue;
            };
            let speed_mps = random.random_range(TRAFFIC_SPEED_MPS);
            elsewhere::place(&car.outline(), &mut self.there);
            let world_from_car = world_from_body * car.body_from_box;
            let velocity_world = world_from_car.rotation * Vector::new(speed_mps, 0.0);
            let returns = along(car.outline(), TRAFFIC_RETURNS_M);
            let returns =
                returns.map(|point| Moving::straight(world_from_body * point, velocity_world));
            self.oracle.imagine(returns);
        }
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

/// A body on the road.
struct Body {
    body_from_box: Pose,
    /// Half its length and half its width, m.
    half_m: (f64, f64),
}

impl Body {
    /// One at a random place on the road, so far ahead of the car; `None` if the car is there.
    fn draw(
        observation: &Observation,
        (ahead_m, kinds_m): (std::ops::Range<f64>, &[(f64, f64)]),
        random: &mut impl Rng,
    ) -> Option<Body> {
        let road = &observation.road;
        let checkpoint = &observation.checkpoints[0];
        let curvature = match checkpoint.bend() {
            Bend::Left if checkpoint.bend_radius_m > 0.0 => 1.0 / checkpoint.bend_radius_m,
            Bend::Right if checkpoint.bend_radius_m > 0.0 => -1.0 / checkpoint.bend_radius_m,
            Bend::Left | Bend::Right | Bend::Straight => 0.0,
        };
        let ahead_m = random.random_range(ahead_m);
        let right_m = road.right_m.max(0.1);
        let aside_m = random.random_range(-right_m..road.left_m.max(0.1));
        let half_m = kinds_m[random.random_range(0..kinds_m.len())];
        let across_m =
            aside_m - ahead_m * road.heading_rad.sin() + 0.5 * curvature * ahead_m * ahead_m;
        let heading_rad = curvature * ahead_m - road.heading_rad + 0.2 * normal(random);
        let [ahead_clear_m, aside_clear_m] = CLEAR_M;
        let in_the_car =
            ahead_m.abs() - half_m.0 < ahead_clear_m && across_m.abs() - half_m.1 < aside_clear_m;
        let body_from_box = vehicle::pose(ahead_m, across_m, heading_rad);
        (!in_the_car).then_some(Body {
            body_from_box,
            half_m,
        })
    }

    fn outline(&self) -> [Point; 4] {
        let (length_m, width_m) = self.half_m;
        [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
            .map(|(x, y)| self.body_from_box * Point::new(x * length_m, y * width_m))
    }
}

/// Points along an outline, at most so far apart.
fn along(outline: [Point; 4], apart_m: f64) -> impl Iterator<Item = Point> {
    (0..4).flat_map(move |corner| {
        let (from, to) = (outline[corner], outline[(corner + 1) % 4]);
        let count = ((to - from).norm() / apart_m).ceil().max(1.0) as usize;
        (0..count).map(move |k| from + (to - from) * (k as f64 / count as f64))
    })
}

/// A normally distributed number (Box and Muller).
fn normal(random: &mut impl Rng) -> f64 {
    let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.random::<f64>()).cos()
}
