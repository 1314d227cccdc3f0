//! Compares predicted observations with those of the built-in world at the same pose.

use learner::elsewhere;
use shm_config::message::{Bend, Observation};
use sim::{World, WorldConfig};
use vehicle::{Action, Point, State, wrap_rad};

/// Only returns nearer than this are compared, m; single beams decide whether a body
/// further away is hit.
const RETURN_MAX_M: f32 = 25.0;
/// Pairs with a return nearer than this are left out, m.
const CLEAR_M: f32 = 3.0;
/// Tolerance of ranges, m.
const RETURN_M: f32 = 0.5;

/// Follows its lane and swings about the centre line.
fn swing(observation: &Observation, tick: u64) -> Action {
    let road = &observation.road;
    let aside_m = 0.5 * (tick as f64 * 0.13).sin();
    Action {
        steer: -(0.8 * road.heading_rad + 0.12 * (road.offset_m - aside_m)),
        pedal: 0.3 * (8.0 - observation.ego.speed_mps),
    }
    .clamped()
}

/// The state of the car at `there` in the body frame of `here`.
fn moved(here: &Observation, there: &Observation) -> State {
    let pose =
        |o: &Observation| vehicle::pose(o.ego.x_world_m, o.ego.y_world_m, o.ego.heading_world_rad);
    let here_from_there = pose(here).inverse() * pose(there);
    State {
        position: Point::from(here_from_there.translation.vector),
        heading_rad: here_from_there.rotation.angle(),
        speed_mps: there.ego.speed_mps,
    }
}

fn checkpoint_world(observation: &Observation, k: usize) -> Point {
    let ego = &observation.ego;
    let world_from_body = vehicle::pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad);
    let checkpoint = &observation.checkpoints[k];
    world_from_body * Point::new(checkpoint.x_body_m, checkpoint.y_body_m)
}

/// Errors of the prediction over many pairs of observations.
#[derive(Default)]
struct Errors {
    pairs: u32,
    left_m: Vec<f64>,
    right_m: Vec<f64>,
    offset_m: Vec<f64>,
    heading_rad: Vec<f64>,
    checkpoint_m: Vec<f64>,
    seen: Beams,
    invented: Beams,
}

/// Number of returns, and of those without a counterpart.
#[derive(Default)]
struct Beams {
    all: u32,
    alone: u32,
}

impl Beams {
    /// Counts the returns of one scan, and those that the other scan lacks both on the
    /// same beam and on its neighbours.
    fn note(&mut self, scan: &[f32], other: &[f32]) {
        for (k, &range_m) in scan.iter().enumerate() {
            if range_m > RETURN_MAX_M {
                continue;
            }
            let beside = [k + scan.len() - 1, k, k + 1].map(|k| other[k % scan.len()]);
            let agrees = beside.iter().any(|m| (m - range_m).abs() < RETURN_M);
            self.all += 1;
            self.alone += u32::from(!agrees);
        }
    }

    fn share(&self) -> f64 {
        f64::from(self.alone) / f64::from(self.all)
    }
}

impl Errors {
    fn note(&mut self, predicted: &Observation, truth: &Observation) {
        self.pairs += 1;
        let (a, b) = (&predicted.road, &truth.road);
        self.left_m.push((a.left_m - b.left_m).abs());
        self.right_m.push((a.right_m - b.right_m).abs());
        self.offset_m.push((a.offset_m - b.offset_m).abs());
        self.heading_rad
            .push(wrap_rad(a.heading_rad - b.heading_rad).abs());
        for (a, b) in predicted.checkpoints.iter().zip(&truth.checkpoints) {
            let off_m = (a.x_body_m - b.x_body_m).hypot(a.y_body_m - b.y_body_m);
            self.checkpoint_m.push(off_m);
        }
        self.seen.note(truth.ranges(), predicted.ranges());
        self.invented.note(predicted.ranges(), truth.ranges());
    }
}

/// The quantile of this share of the numbers.
fn quantile(numbers: &mut [f64], share: f64) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers[((numbers.len() - 1) as f64 * share) as usize]
}

/// Drives episodes without traffic and compares observations this many ticks apart; the
/// result is grouped by the bend that the car is in.
fn compare(apart: usize) -> [Errors; 3] {
    let mut errors = [(); 3].map(|()| Errors::default());
    let mut world = World::new(WorldConfig {
        traffic_density: 0.0,
        accident_probability: 1.0,
        ..WorldConfig::default()
    })
    .expect("a world");
    let mut predicted = Box::<Observation>::default();
    for seed in 0..30 {
        world.reset(seed).expect("a map");
        let mut seen: Vec<Box<Observation>> = Vec::new();
        for tick in 0..600 {
            let mut observation = Box::<Observation>::default();
            world.observe(&mut observation);
            let action = swing(&observation, tick);
            seen.push(observation);
            world.step(action);
            if world.last_step().has_ended() {
                break;
            }
        }
        for (here, there) in seen.iter().zip(&seen[apart.min(seen.len())..]) {
            // The car is on the same road if the next checkpoint and the lane are the
            // same.
            let same = (checkpoint_world(here, 0) - checkpoint_world(there, 0)).norm() < 1e-6;
            let width_m = |o: &Observation| o.road.left_m + o.road.right_m;
            // A car inside a cone would see it from within.
            let nearest_m = |o: &Observation| o.ranges().iter().fold(50.0_f32, |m, &r| m.min(r));
            let is_clear = nearest_m(here).min(nearest_m(there)) > CLEAR_M;
            if !is_clear || !same || (width_m(here) - width_m(there)).abs() > 1e-6 {
                continue;
            }
            let obeyed = (there.ego.steer, there.ego.pedal);
            elsewhere::observe(here, &moved(here, there), obeyed, &mut predicted);
            errors[here.checkpoints[0].bend() as usize].note(&predicted, there);
        }
    }
    errors
}

#[test]
fn predicted_observations_equal_those_of_the_world() {
    // Distance in ticks, and the share of returns that may have come into view, left
    // it, or lie between two beams.
    for (apart, unseen, invented) in [(1, 0.15, 0.15), (4, 0.25, 0.25), (10, 0.5, 0.35)] {
        for (bend, mut errors) in Bend::ALL.iter().zip(compare(apart)) {
            let what = format!("{apart} ticks apart, {bend:?}, {} pairs", errors.pairs);
            assert!(errors.pairs > 500, "{what}");
            for (name, numbers, most) in [
                ("left, m", &mut errors.left_m, 0.01),
                ("right, m", &mut errors.right_m, 0.01),
                ("heading, rad", &mut errors.heading_rad, 0.001),
                ("checkpoints, m", &mut errors.checkpoint_m, 0.01),
            ] {
                let worst = quantile(numbers, 1.0);
                assert!(worst < most, "{what}: {name} is off by {worst}");
            }
            // The offset is that of the lane the car is in, which may be a neighbouring
            // one.
            let offset_m = quantile(&mut errors.offset_m, 0.99);
            assert!(offset_m < 0.01, "{what}: the offset is off by {offset_m}");
            let (seen, made_up) = (&errors.seen, &errors.invented);
            assert!(seen.all > 200, "{what}: {} returns", seen.all);
            let share = seen.share();
            assert!(
                share < unseen,
                "{what}: {share:.3} of {} are missed",
                seen.all
            );
            let share = made_up.share();
            assert!(
                share < invented,
                "{what}: {share:.3} of {} are invented",
                made_up.all
            );
        }
    }
}
