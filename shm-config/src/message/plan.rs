use vehicle::{Action, Point, Pose, pose};

use super::observation::SPEED_LIMIT_MPS;
use super::{Header, Lateness, Message, Refusal, fits, header_accessors, known, within};
use crate::settings::Late;

/// Largest distance of a plan from the car, m.
const FAR_M: f64 = 1e4;
/// Most waypoints of a plan: 30 m at the 2 m step needs 15, rewired trees fewer.
pub const WAYPOINTS_MAX: usize = 64;

crate::word_list! {
    /// The result of a search within its budget.
    pub enum PlanOutcome {
        /// A path into the goal ball.
        Reached = 0 "reached",
        /// No path to the goal; the waypoints lead to the node nearest to it.
        Partial = 1 "partial",
        /// No free step, or a dead end too near to be of use; no waypoints.
        Blocked = 2 "blocked",
    }
}

crate::message! {
    /// One point of a path.
    #[derive(Default)]
    pub struct Waypoint: 24 bytes {
        /// m, forward, in the body frame at the plan's observation.
        pub x_body_m: f64,
        /// m, left, in the body frame at the plan's observation.
        pub y_body_m: f64,
        /// Desired speed at this point, m/s.
        pub speed_mps: f64,
    }
}

/// Most actions of a plan: 3.2 s at the 0.1 s step.
pub const PLANNED_MAX: usize = 32;

crate::message! {
    /// One action of a plan that contains actions and not only a path.
    #[derive(Default)]
    pub struct PlannedAction: 16 bytes {
        /// Normalised, in [-1, 1], positive left.
        pub steer: f64,
        /// Normalised, in [-1, 1], positive drives.
        pub pedal: f64,
    }
}

crate::message! {
    /// The planner's answer to one observation.
    pub struct Plan: 2168 bytes, nested [Header, Waypoint, PlannedAction] {
        /// The observation's tick; taken when the observation was.
        pub header: Header,
        /// Pose of the body frame of the waypoints in the world frame: m.
        pub origin_x_world_m: f64,
        /// m.
        pub origin_y_world_m: f64,
        /// rad.
        pub origin_heading_world_rad: f64,
        /// The goal searched for, m forward.
        pub goal_x_body_m: f64,
        /// The goal searched for, m left.
        pub goal_y_body_m: f64,
        /// Length of the path, m.
        pub cost_m: f64,
        /// Time the planner took, ns on the machine's clock.
        pub planning_ns: u64,
        /// A [`PlanOutcome`].
        pub outcome: u32,
        /// Iterations spent.
        pub iterations: u32,
        /// Nodes of the tree.
        pub nodes: u32,
        /// How many waypoints are valid.
        pub waypoint_count: u32,
        /// The path from the body's origin outwards; the origin itself first.
        pub waypoints: [Waypoint; 64],
        /// How long each action holds, s.
        pub action_step_s: f64,
        /// The number of valid actions; 0 for a plan that is only a path.
        pub action_count: u32,
        /// A [`Lateness`]: of the plan.
        pub lateness: u32,
        /// The actions from the plan's observation on, in order.
        pub actions: [PlannedAction; 32],
    }
}

const _: () = assert!(
    WAYPOINTS_MAX == 64 && PLANNED_MAX == 32,
    "as the message declares"
);

impl Default for Plan {
    fn default() -> Self {
        Self {
            header: Header::default(),
            origin_x_world_m: 0.0,
            origin_y_world_m: 0.0,
            origin_heading_world_rad: 0.0,
            goal_x_body_m: 0.0,
            goal_y_body_m: 0.0,
            cost_m: 0.0,
            planning_ns: 0,
            outcome: PlanOutcome::Blocked.code(),
            iterations: 0,
            nodes: 0,
            waypoint_count: 0,
            waypoints: [Waypoint::default(); WAYPOINTS_MAX],
            action_step_s: 0.0,
            action_count: 0,
            lateness: Lateness::OnTime.code(),
            actions: [PlannedAction::default(); PLANNED_MAX],
        }
    }
}

impl Message for Plan {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        let position = -1e6..=1e6;
        within("origin_x_world_m", self.origin_x_world_m, position.clone())?;
        within("origin_y_world_m", self.origin_y_world_m, position)?;
        within(
            "origin_heading_world_rad",
            self.origin_heading_world_rad,
            -1e3..=1e3,
        )?;
        within("goal_x_body_m", self.goal_x_body_m, -FAR_M..=FAR_M)?;
        within("goal_y_body_m", self.goal_y_body_m, -FAR_M..=FAR_M)?;
        within("cost_m", self.cost_m, 0.0..=FAR_M)?;
        known("outcome", self.outcome, PlanOutcome::from_code)?;
        known("lateness", self.lateness, Lateness::from_code)?;
        fits(
            "waypoint_count",
            u64::from(self.waypoint_count),
            WAYPOINTS_MAX,
        )?;
        // A single pass without an early exit; the faulty element is searched only
        // after a failure.
        let good = self.waypoints().iter().fold(true, |good, waypoint| {
            good & (waypoint.x_body_m.abs() <= FAR_M)
                & (waypoint.y_body_m.abs() <= FAR_M)
                & (waypoint.speed_mps >= 0.0)
                & (waypoint.speed_mps <= SPEED_LIMIT_MPS)
        });
        if !good {
            for waypoint in self.waypoints() {
                within("waypoint.x_body_m", waypoint.x_body_m, -FAR_M..=FAR_M)?;
                within("waypoint.y_body_m", waypoint.y_body_m, -FAR_M..=FAR_M)?;
                let speeds = 0.0..=SPEED_LIMIT_MPS;
                within("waypoint.speed_mps", waypoint.speed_mps, speeds)?;
            }
        }
        fits("action_count", u64::from(self.action_count), PLANNED_MAX)?;
        let steps_s = match self.action_count {
            0 => 0.0..=10.0,
            _ => 1e-3..=10.0,
        };
        within("action_step_s", self.action_step_s, steps_s)?;
        for action in self.actions() {
            within("action.steer", action.steer, -1.0..=1.0)?;
            within("action.pedal", action.pedal, -1.0..=1.0)?;
        }
        Ok(())
    }
}

impl Plan {
    /// The result; an unknown code is read as blocked.
    pub fn outcome(&self) -> PlanOutcome {
        PlanOutcome::from_code(self.outcome).unwrap_or(PlanOutcome::Blocked)
    }

    /// Applies `deadlines.planner` to a plan that is late. Returns whether it is published.
    pub fn answer_late(&mut self, policy: Late) -> bool {
        if policy == Late::Brake {
            self.outcome = PlanOutcome::Blocked.code();
            (self.waypoint_count, self.action_count) = (0, 0);
        }
        self.lateness = Lateness::of(policy).code();
        policy != Late::Skip
    }

    /// The valid waypoints; at most the capacity, even if the count is larger.
    pub fn waypoints(&self) -> &[Waypoint] {
        &self.waypoints[..(self.waypoint_count as usize).min(WAYPOINTS_MAX)]
    }

    /// The valid actions; at most the capacity, even if the count is larger.
    pub fn actions(&self) -> &[PlannedAction] {
        &self.actions[..(self.action_count as usize).min(PLANNED_MAX)]
    }

    /// The action planned for an instant, by its age after the plan's
    /// observation; `None` when the plan has none so far ahead, or none at all.
    pub fn action_at(&self, age_ns: u64) -> Option<Action> {
        let index = (age_ns as f64 * 1e-9 / self.action_step_s + 1e-6) as usize;
        let planned = self.actions().get(index)?;
        Some(Action {
            steer: planned.steer,
            pedal: planned.pedal,
        })
    }

    /// The waypoint to steer for (Sec. 4.1.1), with its speed, m/s: the nearest of
    /// those at least `distance_m` away, else the last; `None` when there is none.
    ///
    /// Distances are measured from the car's present position, which may have moved
    /// since the plan was made; waypoints that it has passed do not count. Only
    /// waypoints count, not the points between them.
    pub fn lookahead(&self, body_from_plan: &Pose, distance_m: f64) -> Option<(Point, f64)> {
        let points = || {
            let waypoints = self.waypoints().iter();
            waypoints.map(|waypoint| (body_from_plan * waypoint.point(), waypoint.speed_mps))
        };
        points()
            .skip(self.passed(body_from_plan))
            .filter(|(point, _)| point.coords.norm() >= distance_m)
            .min_by(|a, b| a.0.coords.norm().total_cmp(&b.0.coords.norm()))
            .or_else(|| points().next_back())
    }

    /// The number of waypoints that the car has passed: those before the end of the
    /// segment nearest to it. None on a path of one point.
    fn passed(&self, body_from_plan: &Pose) -> usize {
        let away_m = |pair: &[Waypoint]| {
            let [from, to] = [&pair[0], &pair[1]].map(|waypoint| body_from_plan * waypoint.point());
            let along = to - from;
            // A piece without a length is its point.
            let length2 = along.norm_squared().max(f64::MIN_POSITIVE);
            let share = (-from.coords.dot(&along) / length2).clamp(0.0, 1.0);
            (from.coords + along * share).norm()
        };
        let pieces = self.waypoints().windows(2).map(away_m).enumerate();
        pieces
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map_or(0, |(piece, _)| piece + 1)
    }

    /// The body frame of the waypoints in the world frame.
    pub fn world_from_plan(&self) -> Pose {
        pose(
            self.origin_x_world_m,
            self.origin_y_world_m,
            self.origin_heading_world_rad,
        )
    }
}

impl Waypoint {
    /// Its position in the plan's body frame, m.
    pub fn point(&self) -> Point {
        Point::new(self.x_body_m, self.y_body_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points every 1.5 m along a left bend of 10 m radius.
    fn bend() -> Plan {
        let mut plan = Plan {
            waypoint_count: 8,
            ..Plan::default()
        };
        for (k, waypoint) in plan.waypoints.iter_mut().take(8).enumerate() {
            let angle_rad = 0.15 * k as f64;
            waypoint.x_body_m = 10.0 * angle_rad.sin();
            waypoint.y_body_m = 10.0 * (1.0 - angle_rad.cos());
        }
        plan
    }

    #[test]
    fn the_waypoint_is_ahead_however_far_the_car_has_come() {
        let plan = bend();
        for tenth in 0..=70_u32 {
            let angle_rad = 0.015 * f64::from(tenth);
            let plan_from_body = pose(
                10.0 * angle_rad.sin(),
                10.0 * (1.0 - angle_rad.cos()),
                angle_rad,
            );
            let (target, _) = plan
                .lookahead(&plan_from_body.inverse(), 2.0)
                .expect("a waypoint");
            let passed_m = 0.15 * f64::from(tenth);
            let left_m = 10.5 - passed_m;
            let ahead = target.x > 0.0 || left_m < 0.1;
            assert!(ahead, "{passed_m} m on: {target}");
            assert!(
                target.coords.norm() < 3.5 && target.coords.norm() > left_m.min(2.0) - 0.1,
                "{passed_m} m on: {target}"
            );
        }
    }

    #[test]
    fn a_fresh_plan_has_nothing_behind_it() {
        let (target, _) = bend()
            .lookahead(&Pose::identity(), 2.0)
            .expect("a waypoint");
        assert_eq!(target, bend().waypoints[2].point());
        let mut point = bend();
        point.waypoint_count = 1;
        assert!(point.lookahead(&Pose::identity(), 2.0).is_some());
        point.waypoint_count = 0;
        assert!(point.lookahead(&Pose::identity(), 2.0).is_none());
    }
}
