use shm_config::config::Controller;
use shm_config::message::{Observation, Plan, PlanOutcome};
use vehicle::{Action, Point, pose};

/// A goal that moved further than this between two ticks is another goal, m:
/// ten times what a car at top speed covers in one period.
const GOAL_JUMP_M: f64 = 10.0;

/// The PD tracking of Sec. 4.1.2: heading to the lookahead waypoint, and speed.
///
/// The derivative of the first tick, and of the first tick towards another goal,
/// is zero: the error jumped because the question changed, not the car.
#[derive(Debug, Clone)]
pub struct Pd {
    config: Controller,
    last: Option<Errors>,
}

#[derive(Debug, Clone, Copy)]
struct Errors {
    heading_rad: f64,
    speed_mps: f64,
    taken_ns: u64,
    episode: u32,
    goal_world: Point,
}

impl Pd {
    /// Tracking with these gains.
    pub fn new(config: Controller) -> Self {
        Self { config, last: None }
    }

    /// The expert's action for a plan, normalised; `None` when the plan has no
    /// free step. The plan may be older than the observation: its waypoints are
    /// moved into the body frame of now.
    pub fn propose(&mut self, plan: &Plan, observation: &Observation) -> Option<Action> {
        if plan.outcome() == PlanOutcome::Blocked {
            self.last = None;
            return None;
        }
        let ego = &observation.ego;
        let world_from_body = pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad);
        let world_from_plan = plan.world_from_plan();
        let body_from_plan = world_from_body.inverse() * world_from_plan;
        let (target_body, speed_mps) = plan.lookahead(&body_from_plan, self.config.lookahead_m)?;
        let now = Errors {
            heading_rad: target_body.y.atan2(target_body.x),
            speed_mps: speed_mps - ego.speed_mps,
            taken_ns: observation.header.taken_ns,
            episode: observation.header.episode,
            goal_world: world_from_plan * Point::new(plan.goal_x_body_m, plan.goal_y_body_m),
        };
        let (heading_rate_radps, speed_rate_mps2) = self.rates(&now);
        self.last = Some(now);
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

    fn rates(&self, now: &Errors) -> (f64, f64) {
        match self.last {
            Some(last)
                if last.episode == now.episode
                    && now.taken_ns > last.taken_ns
                    && (last.goal_world - now.goal_world).norm() < GOAL_JUMP_M =>
            {
                let step_s = (now.taken_ns - last.taken_ns) as f64 * 1e-9;
                (
                    (now.heading_rad - last.heading_rad) / step_s,
                    (now.speed_mps - last.speed_mps) / step_s,
                )
            }
            _ => (0.0, 0.0),
        }
    }
}
