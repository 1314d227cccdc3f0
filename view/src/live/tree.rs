//! The search tree of a step: it is in no message, so the step's observation is planned
//! for again, on request.

use planner::Planner;
use recorder::standard::Branch;
use serde::Serialize;
use shm_config::Message as _;
use shm_config::config::Config;
use shm_config::message::{Plan, Step};

use super::scene::rounded;
use crate::draw::plan::branches;

/// The tree of a step's search.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SearchTree {
    /// The tick.
    pub tick: u64,
    /// Pose of its body frame in the world frame: m, m, rad.
    pub origin_world: [f64; 3],
    /// The way to each node from the one before it, in the body frame, m.
    pub ways: Vec<Vec<[f64; 2]>>,
    /// The cost-to-come of each node as a share of the greatest, [0, 1].
    pub costs: Vec<f64>,
}

/// Plans for a step's observation and keeps the tree; empty for a planner without one.
/// A planner with a memory begins anew, so its tree may differ from the one that drove.
///
/// # Errors
/// When the configuration or the observation is refused.
pub fn search(config: &Config, step: &Step) -> anyhow::Result<SearchTree> {
    let observation = &step.observation;
    observation.check()?;
    let mut planner = Planner::new(config)?;
    let mut plan = Box::<Plan>::default();
    planner.plan(observation, &mut plan);
    let branches = recorder::standard::branches(&planner).unwrap_or_default();
    let greatest_m = branches::greatest_cost_m(&branches);
    let ego = &observation.ego;
    let drawn = branches.iter().filter(|branch| branch.way_body.len() > 1);
    let way = |branch: &Branch| {
        let points = branch.way_body.iter();
        points
            .map(|point| [rounded(point.x, 2), rounded(point.y, 2)])
            .collect()
    };
    Ok(SearchTree {
        tick: step.header.tick,
        origin_world: [ego.x_world_m, ego.y_world_m, ego.heading_world_rad],
        ways: drawn.clone().map(way).collect(),
        costs: drawn
            .map(|branch| rounded(branch.cost_m / greatest_m, 3))
            .collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tree_of_an_open_road_grows_from_the_car() {
        let mut step = Step::default();
        step.observation.beam_count = 240;
        step.observation.ranges_m.fill(50.0);
        (step.observation.road.left_m, step.observation.road.right_m) = (5.0, 5.0);
        step.observation.checkpoints[0].x_body_m = 30.0;
        let tree = search(&Config::default(), &step).expect("a tree");
        assert!(tree.ways.len() > 10, "{} ways", tree.ways.len());
        assert_eq!(tree.ways.len(), tree.costs.len());
        assert!(tree.ways.iter().any(|way| way[0] == [0.0, 0.0]));
        step.observation.ego.speed_mps = f64::NAN;
        assert!(search(&Config::default(), &step).is_err());
    }
}
