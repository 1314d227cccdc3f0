use shm_config::message::{Plan, PlanOutcome, WAYPOINTS_MAX, Waypoint};
use shm_config::settings::Kinodynamic as Settings;
use shm_config::settings::planner::NODES_MAX;
#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::Pose;

use super::search::Search;
use crate::{Dubins, PlannerConfig};

/// Waypoints are no nearer than this to each other along the path, m: a quarter
/// of the lookahead.
const APART_M: f64 = 0.5;

/// One edge of the path.
#[derive(Debug, Clone, Copy)]
struct Leg {
    begin_m: f64,
    from: Pose,
    curve: Dubins,
}

/// The way from the car to a node, as its curves.
#[derive(Debug)]
pub struct Path {
    /// Nodes from the last to the first; scratch.
    back: heapless::Vec<u16, NODES_MAX>,
    legs: heapless::Vec<Leg, NODES_MAX>,
    length_m: f64,
}

impl Path {
    /// Without curves.
    pub const fn empty() -> Self {
        Self {
            back: heapless::Vec::new(),
            legs: heapless::Vec::new(),
            length_m: 0.0,
        }
    }

    /// Collects the curves to a node. They are computed anew: the same poses
    /// give the same curve.
    pub(super) fn follow(&mut self, search: &Search, end: usize, radius_m: f64) {
        self.back.clear();
        self.legs.clear();
        self.back
            .extend(search.tree.way_back(end).map(|index| index as u16));
        self.length_m = 0.0;
        for edge in self.back.windows(2).rev() {
            let [to, from] = [edge[0], edge[1]].map(|index| search.poses[usize::from(index)]);
            let curve = Dubins::shortest(&from, &to, radius_m);
            let leg = Leg {
                begin_m: self.length_m,
                from,
                curve,
            };
            // The capacity is that of the tree.
            let _ = self.legs.push(leg);
            self.length_m += curve.length_m();
        }
    }

    /// Writes waypoints evenly along the path, the last at its end.
    pub(super) fn write(&self, config: &PlannerConfig, settings: &Settings, out: &mut Plan) {
        let intervals = (self.length_m / APART_M) as usize;
        let intervals = intervals.clamp(1, WAYPOINTS_MAX - 1);
        let apart_m = self.length_m / intervals as f64;
        // The car must stand at the end of a path that does not reach the goal.
        let mut next_mps = match out.outcome() {
            PlanOutcome::Reached => config.speed_mps,
            PlanOutcome::Partial | PlanOutcome::Blocked => 0.0,
        };
        let mut leg = self.legs.len();
        for index in (0..=intervals).rev() {
            let distance_m = index as f64 * apart_m;
            while leg > 1
                && self
                    .legs
                    .get(leg - 1)
                    .is_some_and(|leg| leg.begin_m > distance_m)
            {
                leg -= 1;
            }
            let Some(leg) = self.legs.get(leg.saturating_sub(1)) else {
                return;
            };
            let within_m = distance_m - leg.begin_m;
            let point = leg.curve.at(&leg.from, within_m).translation.vector;
            let curvature_per_m = leg.curve.curvature_per_m(within_m).abs();
            let bend_mps = (settings.lateral_mps2 / curvature_per_m).sqrt();
            let brake_mps = (next_mps * next_mps + 2.0 * settings.brake_mps2 * apart_m).sqrt();
            let last = index == intervals;
            let speed_mps =
                config
                    .speed_mps
                    .min(bend_mps)
                    .min(if last { next_mps } else { brake_mps });
            out.waypoints[index] = Waypoint {
                x_body_m: point.x,
                y_body_m: point.y,
                speed_mps,
            };
            next_mps = speed_mps;
        }
        out.waypoint_count = intervals as u32 + 1;
        out.cost_m = self.length_m;
    }
}
