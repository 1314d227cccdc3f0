use shm_config::message::{Observation, PdState, Plan, PlanOutcome};
use shm_config::settings::Controller;
#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Action, Point, pose};

/// A goal that moved further than this between two ticks is another goal, m:
/// ten times what a car at top speed covers in one period.
const GOAL_JUMP_M: f64 = 10.0;

/// The PD tracking of Sec. 4.1.2: heading to the lookahead waypoint, and speed.
///
/// The derivative of the first tick, and of the first tick towards another goal,
/// is zero: the error jumped because the goal changed, not because the car moved.
#[derive(Debug, Clone)]
pub struct Pd {
    config: Controller,
    /// The errors of the last tick that tracked.
    last: PdState,
}

impl Pd {
    /// Tracking with these gains.
    pub fn new(config: Controller) -> Self {
        Self {
            config,
            last: PdState::default(),
        }
    }

    /// What the next tick differentiates against.
    pub fn state(&self) -> PdState {
        self.last
    }

    /// Restores this state.
    pub fn restore(&mut self, state: &PdState) {
        self.last = *state;
    }

    /// The expert's action for a plan, normalised; `None` when the plan has no
    /// free step. The plan may be older than the observation: its waypoints are
    /// moved into the body frame of now.
    pub fn propose(&mut self, plan: &Plan, observation: &Observation) -> Option<Action> {
        if plan.outcome() == PlanOutcome::Blocked {
            self.last = PdState::default();
            return None;
        }
        let ego = &observation.ego;
        let world_from_body = pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad);
        let world_from_plan = plan.world_from_plan();
        let body_from_plan = world_from_body.inverse() * world_from_plan;
        let (target_body, speed_mps) = plan.lookahead(&body_from_plan, self.config.lookahead_m)?;
        let goal_world = world_from_plan * Point::new(plan.goal_x_body_m, plan.goal_y_body_m);
        let now = PdState {
            heading_rad: target_body.y.atan2(target_body.x),
            speed_mps: speed_mps - ego.speed_mps,
            taken_ns: observation.header.taken_ns,
            episode: observation.header.episode,
            goal_x_world_m: goal_world.x,
            goal_y_world_m: goal_world.y,
            present: 1,
        };
        let (heading_rate_radps, speed_rate_mps2) = self.rates(&now);
        self.last = now;
        let Controller {
            steer_kp,
            steer_kd,
            pedal_kp,
            pedal_kd,
            ..
        } = self.config;
        let action = Action {
            steer: steer_kp * now.heading_rad + steer_kd * heading_rate_radps,
            pedal: pedal_kp * now.speed_mps + pedal_kd * speed_rate_mps2,
        };
        Some(action.clamped())
    }

    /// Change of both errors since the last tick, rad/s and m/s².
    fn rates(&self, now: &PdState) -> (f64, f64) {
        let last = &self.last;
        let is_same_question = last.present == 1
            && last.episode == now.episode
            && now.taken_ns > last.taken_ns
            && (goal_world(last) - goal_world(now)).norm() < GOAL_JUMP_M;
        if !is_same_question {
            return (0.0, 0.0);
        }
        let step_s = (now.taken_ns - last.taken_ns) as f64 * 1e-9;
        (
            (now.heading_rad - last.heading_rad) / step_s,
            (now.speed_mps - last.speed_mps) / step_s,
        )
    }
}

fn goal_world(state: &PdState) -> Point {
    Point::new(state.goal_x_world_m, state.goal_y_world_m)
}
