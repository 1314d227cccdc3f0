//! A straight, empty road, a plan along it, and a policy that always says the
//! same.

#![allow(dead_code)] // not every test file needs all of it

use controller::Policy;
use shm_config::Instant;
use shm_config::message::{Observation, Plan, PlanOutcome, Waypoint};
use vehicle::Action;

/// The tick that observation and plan are of.
const TICK: u64 = 5;

/// Always proposes this.
pub struct Fixed(pub Action);

impl Policy for Fixed {
    fn infer(&mut self, features: &[f32]) -> Option<Action> {
        assert_eq!(features.len(), 259, "as the policy was trained");
        Some(self.0)
    }
    fn version(&self) -> u64 {
        7
    }
    fn hash(&self) -> u64 {
        0xABCD
    }
}

/// A straight road of 10.5 m with the car in its middle.
pub fn observation(now: Instant) -> Observation {
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.header.taken_ns = now.0;
    observation.header.tick = TICK;
    observation.ranges_m[..240].fill(50.0);
    observation.road.left_m = 5.25;
    observation.road.right_m = 5.25;
    observation.ego.speed_mps = 5.0;
    for checkpoint in &mut observation.checkpoints {
        checkpoint.x_body_m = 40.0;
    }
    observation
}

/// The same with a wall of returns just before the bumper.
pub fn wall(now: Instant) -> Observation {
    let mut observation = observation(now);
    for beam in (0..4).chain(237..240) {
        observation.ranges_m[beam] = 4.2;
    }
    observation
}

/// A plan that drifts to the left by `left_m` in each waypoint's 1.5 m.
pub fn plan(now: Instant, left_m: f64) -> Plan {
    let mut plan = Plan {
        outcome: PlanOutcome::Reached.code(),
        waypoint_count: 4,
        ..Plan::default()
    };
    plan.header.taken_ns = now.0;
    plan.header.tick = TICK;
    for (k, waypoint) in plan.waypoints.iter_mut().take(4).enumerate() {
        *waypoint = Waypoint {
            x_body_m: 1.5 * k as f64,
            y_body_m: left_m * k as f64,
            speed_mps: 5.0,
        };
    }
    plan
}
