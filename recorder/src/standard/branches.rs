//! The search tree of a plan.

use planner::{Dubins, Kinodynamic, Planner, PoseNode, Tree};
use vehicle::Point;

/// Maximum length of the chords of a curve, m: in the car's tightest turn, of 2.9 m
/// radius, they deviate from the arc by 3 mm.
const CHORD_M: f64 = 0.25;

/// A node and the edge to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Branch {
    /// The node, in the body frame, m.
    pub node_body: Point,
    /// Points of the edge from the parent node; empty at the start.
    pub way_body: Vec<Point>,
    /// Cost-to-come, m.
    pub cost_m: f64,
}

/// The tree of the last plan; `None` for a method without a tree.
pub fn branches(planner: &Planner) -> Option<Vec<Branch>> {
    match planner {
        Planner::Kinodynamic(planner) => Some(curved(planner)),
        planner => planner.tree().map(straight),
    }
}

fn straight(tree: &Tree) -> Vec<Branch> {
    let branch = |node: planner::Node| {
        let parent = node.parent.and_then(|index| tree.node(index));
        Branch {
            node_body: node.point_body,
            way_body: parent.map_or(vec![], |parent| vec![parent.point_body, node.point_body]),
            cost_m: node.cost_m,
        }
    };
    tree.nodes().map(branch).collect()
}

fn curved(planner: &Kinodynamic) -> Vec<Branch> {
    let nodes: Vec<PoseNode> = planner.nodes().collect();
    let way = |node: &PoseNode, parent: &PoseNode| {
        let (from, to) = (parent.body_from_node, node.body_from_node);
        // The same poses give the curve that the planner used.
        let curve = Dubins::shortest(&from, &to, planner.radius_m());
        let length_m = curve.length_m();
        let chords = (length_m / CHORD_M).ceil().max(1.0) as usize;
        let at = |k| curve.at(&from, length_m * k as f64 / chords as f64);
        let places = (0..=chords).map(|k| at(k).translation.vector.into());
        places.collect()
    };
    let branch = |node: &PoseNode| {
        let parent = node.parent.and_then(|index| nodes.get(index));
        Branch {
            node_body: node.body_from_node.translation.vector.into(),
            way_body: parent.map_or(vec![], |parent| way(node, parent)),
            cost_m: node.cost_m,
        }
    };
    nodes.iter().map(branch).collect()
}
