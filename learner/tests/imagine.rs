//! What the expert knows at imagined states.

use learner::elsewhere;
use shm_config::config::Config;
use shm_config::config::planner::Method;
use shm_config::message::Observation;
use stack::oracle::Oracle;
use vehicle::{Point, State};

const STEP_NS: u64 = 100_000_000;
/// Speed of the ego and of the car ahead, m/s.
const SPEED_MPS: f64 = 5.0;

/// A straight road of three lanes, and a car ahead in each.
fn behind_cars(tick: u64, away_m: f64) -> Observation {
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.ranges_m[..240].fill(50.0);
    (observation.header.tick, observation.header.taken_ns) = (tick, tick * STEP_NS);
    observation.ego.x_world_m = tick as f64 * 1e-9 * STEP_NS as f64 * SPEED_MPS;
    observation.ego.speed_mps = SPEED_MPS;
    (observation.road.left_m, observation.road.right_m) = (5.25, 5.25);
    for checkpoint in &mut observation.checkpoints {
        checkpoint.x_body_m = 60.0;
    }
    for lane_m in [-3.5, 0.0, 3.5] {
        let corner = |x: f64, y: f64| Point::new(away_m + 2.3 * x, lane_m + 0.9 * y);
        let corners = [
            corner(1.0, 1.0),
            corner(-1.0, 1.0),
            corner(-1.0, -1.0),
            corner(1.0, -1.0),
        ];
        elsewhere::place(&corners, &mut observation);
    }
    observation
}

fn oracle() -> Oracle {
    let mut config = Config::default();
    config.planner.method = Method::Mpc;
    Oracle::new(&config).expect("an expert")
}

/// A row of cars ahead, as fast as the ego, is followed; if they stood, it would brake. From
/// beside where the scan was taken, too.
#[test]
fn the_expert_knows_what_moves_where_it_is_asked() {
    let mut oracle = oracle();
    let pedal = |oracle: &mut Oracle, left_m: f64| {
        let here = behind_cars(20, 12.0);
        let mut state = State::at_origin(SPEED_MPS);
        state.position.y = left_m;
        let mut there = Observation::default();
        elsewhere::observe(&here, &state, (0.0, 0.0), &mut there);
        oracle.ask(&mut there).pedal
    };
    let standing = [0.0, 0.6].map(|left_m| pedal(&mut oracle, left_m));
    for tick in 0..=20 {
        oracle.watch(&behind_cars(tick, 12.0));
    }
    let moving = [0.0, 0.6].map(|left_m| pedal(&mut oracle, left_m));
    println!("standing {standing:?}, moving {moving:?}");
    for (standing, moving) in standing.into_iter().zip(moving) {
        assert!(standing < -0.2 && moving > -0.1, "{standing} {moving}");
    }
    // Of another episode, nothing is known.
    let mut other = behind_cars(21, 12.0);
    other.header.episode = 1;
    oracle.watch(&other);
    assert_eq!(pedal(&mut oracle, 0.0), standing[0]);
}
